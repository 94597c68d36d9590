"""Parts of pages: types of their keys, questions, scales, codes of return."""

from __future__ import annotations

import string
from typing import Annotated, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator
from pydantic_core import PydanticCustomError

Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_+-]*$", max_length=60)]
ParameterPath = Annotated[str, Field(pattern=r"^[^.\s]+(\.[^.\s]+)*$", max_length=200)]
Language = Annotated[str, Field(pattern=r"^[a-z]{2,3}(-[A-Za-z0-9]{2,8})*$")]
Text = str | dict[Language, str]
Levels = dict[str, str]
Pairs = dict[str, Literal["all"] | list[str] | list[list[str]]]


class Section(BaseModel):
    """A part of a manifest: unknown keys are refused, values are not converted."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)


class Question(Section):
    """One question of a questionnaire."""

    name: Name = Field(description="column of the table of answers")
    label: Text = Field(description="words of the question")
    kind: Literal["text", "number", "choice", "scale"] = Field(default="text", description="how it is answered")
    choices: dict[Name, Text] | None = Field(default=None, description="name -> words, of kind choice")
    low: float = Field(default=1.0, description="least number, or left end of a scale")
    high: float = Field(default=5.0, description="greatest number, or right end of a scale")
    optional: bool = Field(default=False, description="may be left out")

    @model_validator(mode="after")
    def _has_choices(self) -> Self:
        if (self.kind == "choice") != (self.choices is not None):
            raise PydanticCustomError("question", "kind: choice and choices belong together")
        if self.low >= self.high:
            raise PydanticCustomError("question", "low must be below high")
        return self


class Return(Section):
    """Code and address by which a panel of paid listeners learns that a listener is back.

    In the address ``{code}`` and ``{listener}`` are filled in; in the code ``{id}`` is the name under which the results
    have a listener who gave none.
    """

    code: str = Field(default="", max_length=200, description="shown to the listener")
    address: Annotated[str, Field(pattern=r"^https?://\S+$", max_length=1000)] | None = Field(
        default=None, description="link back to the panel"
    )

    @model_validator(mode="after")
    def _can_be_filled_in(self) -> Self:
        for text, names in ((self.code, {"id"}), (self.address or "", {"code", "listener"})):
            try:
                parts = [part for _, *part in string.Formatter().parse(text) if part[0] is not None]
            except ValueError as fault:
                raise PydanticCustomError("return", f"{text}: {fault}") from None
            fields = {f"{name}{f'!{mark}' if mark else ''}{f':{spec}' if spec else ''}" for name, spec, mark in parts}
            if unknown := fields - names:
                raise PydanticCustomError("return", f"{{{min(unknown)}}} is not one of {', '.join(sorted(names))}")
        return self


class RatingScale(Section):
    """A scale from `low` to `high` with words at its ends."""

    name: Name = Field(description="column of the table of answers")
    label: Text = Field(description="words of the scale")
    low: float = Field(default=0.0, description="number at the left end")
    high: float = Field(default=100.0, description="number at the right end")
    low_label: Text = Field(default="", description="words at the left end")
    high_label: Text = Field(default="", description="words at the right end")
    ordinal: bool = Field(default=False, description="grades have an order, but no stated distance")

    @model_validator(mode="after")
    def _rises(self) -> Self:
        if self.low >= self.high:
            raise PydanticCustomError("scale", "low must be below high")
        return self
