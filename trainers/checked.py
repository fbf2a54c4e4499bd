"""Pydantic models that say in plain words what is wrong."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from difflib import get_close_matches
from typing import Any

from pydantic import (
    BaseModel,
    ConfigDict,
    ModelWrapValidatorHandler,
    ValidationError,
    model_validator,
)
from pydantic_core import InitErrorDetails, PydanticCustomError

__all__ = ["Checked", "in_words"]

PLAIN = "setting"
"""The type of a finding that is in plain words already."""


class Checked(BaseModel):
    """Takes the types that it names and no other keys; each finding is one line without a link."""

    model_config = ConfigDict(
        extra="forbid", strict=True, allow_inf_nan=False, hide_input_in_errors=True
    )

    def _check(self) -> None:
        """Raise a ValueError where values contradict one another."""

    @model_validator(mode="wrap")
    @classmethod
    def _said_plainly(cls, values: Any, handler: ModelWrapValidatorHandler[Any]) -> Any:
        try:
            checked = handler(values)
            checked._check()
            return checked
        except ValidationError as error:
            found = [
                _finding(e["loc"], in_words(e, cls.model_fields), e["input"])
                for e in error.errors()
            ]
        except ValueError as error:
            found = [_finding((), str(error), values)]
        raise ValidationError.from_exception_data(cls.__name__, found)


def in_words(error: Mapping[str, Any], known: Iterable[str] = ()) -> str:
    """Return one of Pydantic's findings as ``expected X, got Y``.

    Args:
        error: An entry of ``ValidationError.errors()``.
        known: Keys that the model has.
    """
    message, given, kind = error["msg"], f"got {error['input']!r}", error["type"]
    if kind == PLAIN:
        return str(message)
    if kind == "value_error":
        return str(error["ctx"]["error"])
    if kind == "missing":
        return "expected a value, got none"
    if kind == "extra_forbidden":
        near = get_close_matches(str(error["loc"][-1]), known, 1)
        others = f"; it takes {', '.join(known)}" if known else ""
        return f"unknown key, {given}" + (f"; did you mean {near[0]}?" if near else others)
    message = re.sub(r"^\w+ should (be|have) ", "", message)
    message = message.replace("String should match pattern", "text that matches")
    article = "a number " if message.startswith(("greater", "less")) else ""
    return f"expected {article}{message}, {given}"


def _finding(where: tuple[int | str, ...], text: str, given: Any) -> InitErrorDetails:
    plain = PydanticCustomError(PLAIN, "{text}", {"text": text})
    return InitErrorDetails(type=plain, loc=where, input=given)
