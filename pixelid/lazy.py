"""Names that load when they are first used, beside subpackages that bear the same names.

`pixelid.fit` is a function to its users and a subpackage to the import system, which sets every subpackage as an
attribute of its parent: after `import pixelid.fit.result` a plain module would show the subpackage instead of the
function.  So the package refuses those assignments (`Face`), and the function lets the subpackage's own names shine
through (`Function`): `px.fit(...)`, `from pixelid.fit import FitResult`, `import pixelid.fit.result as r` and string
targets of `mock.patch` all work, in every order.
"""

from __future__ import annotations

import importlib
import importlib.util
import sys
from collections.abc import Callable, Mapping
from types import ModuleType
from typing import Any


class Function:
    """A function that a subpackage shares its name with: called, the function; asked for other names, the subpackage.

    name: of both, in `package`;  function: what is called
    """

    def __init__(self, package: str, name: str, function: Callable[..., Any]) -> None:
        self.__dict__.update(  # not by assignment, which goes to the subpackage
            _subpackage=f"{package}.{name}",
            __wrapped__=function,
            __doc__=function.__doc__,
            __module__=package,
            __name__=name,
            __qualname__=name,
        )

    def __call__(self, *args: Any, **options: Any) -> Any:
        return self.__dict__["__wrapped__"](*args, **options)

    def __getattr__(self, name: str) -> Any:
        return getattr(importlib.import_module(self.__dict__["_subpackage"]), name)

    def __setattr__(self, name: str, value: Any) -> None:
        setattr(importlib.import_module(self.__dict__["_subpackage"]), name, value)

    def __delattr__(self, name: str) -> None:
        delattr(importlib.import_module(self.__dict__["_subpackage"]), name)

    def __repr__(self) -> str:
        return f"<function {self.__dict__['_subpackage']}>"

    def __reduce__(self) -> str:
        return self.__dict__["__qualname__"]


class Face(ModuleType):
    """A package that shows a few names, each imported when it is first asked for.

    `_homes`: name → module that defines it
    """

    _homes: Mapping[str, str]

    def __getattr__(self, name: str) -> Any:
        home = self.__dict__["_homes"].get(name)
        if home is None:
            raise AttributeError(f"module {self.__name__!r} has no attribute {name!r}")
        value = getattr(importlib.import_module(home), name)
        if f"{self.__name__}.{name}" in sys.modules or importlib.util.find_spec(f"{self.__name__}.{name}"):
            value = Function(self.__name__, name, value)
        self.__dict__[name] = value
        return value

    def __setattr__(self, name: str, value: Any) -> None:
        if isinstance(value, ModuleType) and name in self.__dict__["_homes"]:
            return  # the import system, offering the subpackage: it is found in sys.modules
        super().__setattr__(name, value)

    def __dir__(self) -> list[str]:
        return [*self.__dict__["_homes"], "__version__"]


def show(package: str, homes: Mapping[str, str]) -> None:
    """Let `package`, while it is imported, show the names of `homes` (name → module) lazily."""
    module = sys.modules[package]
    module.__dict__["_homes"] = homes
    module.__class__ = Face
