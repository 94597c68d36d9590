"""Options of commands, made from the fields of `RenderOptions`."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Collection
from functools import wraps
from types import NoneType
from typing import Annotated, Any, get_args, get_origin

import typer
from pydantic.fields import FieldInfo

from tonewood.errors import TonewoodError
from tonewood.sound.render.options import RenderOptions, choices, limits
from tonewood.support.units import number_in
from tonewood.support.validation_messages import unit_of

#: options whose names leave out the unit; their help texts state it
_NAMES = {"gain_db": "--gain", "tail_level_db": "--tail-level", "room_mix_db": "--room-mix"}


def option_name(field: str) -> str:
    """Name on the command line of a field of `RenderOptions`."""
    return _NAMES.get(field, "--" + field.replace("_", "-"))


def takes_render_options(without: Collection[str] = ()) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Let a command have an option per field of `RenderOptions` instead of its parameter `options`.

    without : fields that make no sense for the command; they keep their defaults.
    """
    fields = {name: field for name, field in RenderOptions.model_fields.items() if name not in without}

    def decorated(command: Callable[..., Any]) -> Callable[..., Any]:
        @wraps(command)
        def wrapped(context: typer.Context, **arguments: Any) -> Any:
            values = {name: arguments.pop(name) for name in fields}
            # a preset stands in for options that are left out, and only for these
            source = context.get_parameter_source
            values = {name: value for name, value in values.items() if getattr(source(name), "name", "") != "DEFAULT"}
            return command(**arguments, options=render_options(values))

        keyword = inspect.Parameter.POSITIONAL_OR_KEYWORD
        parameters = [inspect.Parameter("context", keyword, annotation=typer.Context)]
        for parameter in inspect.signature(command, eval_str=True).parameters.values():
            whole = parameter.name == "options"
            parameters += [_parameter(*item) for item in fields.items()] if whole else [parameter]
        wrapped.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]  # typer reads it
        wrapped.__annotations__ = {p.name: p.annotation for p in parameters}
        return wrapped

    return decorated


def render_options(values: dict[str, Any]) -> RenderOptions:
    """Check the values of a command line. Raises TonewoodError : names the option and the values allowed."""
    numbers = {name for name in values if _takes_number(RenderOptions.model_fields[name])}
    settings = {name: _number(value) if name in numbers else value for name, value in values.items()}
    try:
        return RenderOptions.of(None, None, settings)
    except TonewoodError as fault:
        raise TonewoodError(fault.reason, key=option_name(fault.key or "")) from None


def _number(text: str) -> float | str:
    """Return the number that a text stands for, or the text if it is a word."""
    return text if math.isnan(number := number_in(text)) else number


def _takes_number(field: FieldInfo) -> bool:
    """Whether a number is allowed beside words."""
    return any(get_origin(member) is Annotated for member in get_args(field.annotation))


def _parameter(name: str, field: FieldInfo) -> inspect.Parameter:
    """Parameter of a command from which typer makes the option."""
    members = get_args(field.annotation) if NoneType in get_args(field.annotation) else (field.annotation,)
    kind: Any = members[0] if limits(field) or members[0] is bool else str
    default = f"{field.default:g}" if kind is str and isinstance(field.default, float) else field.default
    option = typer.Option(
        option_name(name),
        help=", ".join(part for part in (field.description, unit_of(field)) if part),
        metavar=_metavar(field) if kind is str else None,
    )
    annotation: Any = Annotated[(kind | None if field.default is None else kind, option)]
    return inspect.Parameter(name, inspect.Parameter.POSITIONAL_OR_KEYWORD, default=default, annotation=annotation)


def _metavar(field: FieldInfo) -> str:
    """Placeholder of the value in the help: the words allowed, and SECONDS or NAMES."""
    words = choices(field.annotation)
    words += ["SECONDS"] if _takes_number(field) else []
    words += ["NAMES"] if any(get_origin(member) is tuple for member in get_args(field.annotation)) else []
    return "|".join(words)
