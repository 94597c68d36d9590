"""Base of all kinds of plugins: parameters, files, the key for errors, and what a class must define."""

from __future__ import annotations

from abc import ABC
from collections.abc import Mapping
from typing import Any, ClassVar, Generic, TypeVar

from tonewood.errors import BundleError
from tonewood.instrument.contract.contract_checks import CHECKS, check_results
from tonewood.instrument.contract.effects import Effect
from tonewood.instrument.contract.files import Files
from tonewood.support.params import Parameters, validated
from tonewood.support.tables import properties_html

#: version of this contract
API = 1

P = TypeVar("P", bound=Parameters)


class Plugin(ABC, Generic[P]):
    """Base of all kinds.

    Parameters
    ----------
    parameters : already checked against `Parameters`.
    files : the bundle's folder, for tables.
    key : of the part in the bundle, e.g. ``strings.E2``, for errors.
    """

    #: version of this contract that the plugin was written for; each class states it, so that a later version can
    #: refuse the class in one line
    api: ClassVar[int] = API
    #: the kind's name, set by the base classes here
    kind: ClassVar[str]
    #: effects of the plugin that a render may leave out
    effects: ClassVar[tuple[Effect, ...]] = ()
    #: pydantic model of the keys the plugin takes in a bundle
    Parameters: ClassVar[type[Parameters]]

    def __init_subclass__(cls, **options: Any):
        """Check the results of the methods that the class defines; see `contract_checks`."""
        super().__init_subclass__(**options)
        check_results(cls, CHECKS.get(getattr(cls, "kind", ""), {}), lambda plugin, reason: plugin.fault(reason))

    def __init__(self, parameters: P, files: Files, key: str = ""):
        self.parameters = parameters
        self.files = files
        self.key = key

    @classmethod
    def from_values(cls, values: Mapping[str, Any], files: Files | None = None, key: str = "") -> Plugin[P]:
        """Make one from plain values, as they stand in a bundle.

        Parameters
        ----------
        values : name of a parameter -> value.
        files : folder of the bundle, for tables; none by default.
        key : of the part in the bundle, for errors.

        Raises
        ------
        BundleError : a value is unknown, missing or out of range.
        """
        files = files or Files(None)
        parameters = validated(
            cls.Parameters, values, key=key, file=files.manifest, context={"files": files, "key": key}
        )
        return cls(parameters, files, key)  # type: ignore[arg-type]  # Parameters of this very class

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.key or self.kind})"

    def _repr_html_(self) -> str:
        heading = f"{type(self).__name__}, {self.kind} {self.key}".rstrip()
        return properties_html(heading, self.parameters.model_dump(mode="json", by_alias=True))

    @classmethod
    def left_out(cls) -> list[str]:
        """Return the names of the contract that the class must define and does not."""
        return sorted(cls.__abstractmethods__)

    @property
    def inner(self) -> tuple[Plugin[Any], ...]:
        """Plugins among its parameters: a string's loss law."""
        return tuple(value for _, value in self.parameters if isinstance(value, Plugin))

    @property
    def name(self) -> str:
        """Name of the part in the bundle: the last word of its key."""
        return self.key.rpartition(".")[2]

    def fault(self, reason: str, key: str = "") -> BundleError:
        """Return an error with this reason that names the bundle's file and the part's key, and a `key` below it."""
        return BundleError(reason, file=self.files.manifest, key=".".join(k for k in (self.key, key) if k))
