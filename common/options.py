"""The fields of settings as options of a command line: their names, and a command that gives the same values again."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple

from pydantic import BaseModel, BeforeValidator, ConfigDict, TypeAdapter, ValidationError
from pydantic.fields import FieldInfo

from gridtrack.common.config import MAX_SHOWN_CHARS, Settings
from gridtrack.common.errors import ConfigurationError

UNITS = {"_s": "SECONDS", "_hz": "HZ", "_mb": "MB"}
"""Endings of fields with a unit, and the metavars of their options, which have names without them."""


@dataclass(frozen=True)
class Option:
    """In the annotation of a field: how its option differs from the rule."""

    name: str = ""
    """Without dashes; empty: the name of the field without its unit."""
    metavar: str = ""
    """Empty: the unit, or the type."""
    argument: bool = False
    """The field is given by its place on the command line."""
    texts: Callable[[Any], Iterable[str]] | None = None
    """The texts of a value in a command, one for each time that the option is given; None: by the type of the value."""
    purpose: str = ""
    """The inputs that have a use for the option; empty: all."""


class OptionField(NamedTuple):
    """A field of settings, or of settings nested in them, as an option."""

    path: tuple[str, ...]
    """Names of the fields from the outer model to this one."""
    field: FieldInfo
    model: type[BaseModel]
    """The model that has the field."""
    name: str
    """Without dashes."""
    metavar: str
    """Empty: the type."""
    own: Option

    def checked(self, value: Any) -> Any:
        """The value that the field has for `value` as a user gave it; the option's name begins every error.

        Raises ConfigurationError.
        """
        kind: Any = Annotated[self.field.annotation, Option(), *self.field.metadata]
        name = self.metavar if self.own.argument else f"--{self.name}"
        try:
            return TypeAdapter(kind, config=ConfigDict(allow_inf_nan=False)).validate_python(value)
        except ConfigurationError as error:
            text = str(error)
            raise ConfigurationError(text if text.startswith(name) else f"{name} {text}") from None
        except ValidationError as error:
            found = error.errors(include_url=False)[0]
            given = value if isinstance(value, str) else found["input"]
            raise ConfigurationError(
                f"{name} {given!s:.{MAX_SHOWN_CHARS}}: {found['msg'].replace('Input', 'it', 1)}"
            ) from None

    def flag(self, value: bool) -> str:
        """The name of the option, without dashes, that gives a truth value."""
        return self.name if value else f"no-{self.name}"


def option_fields(model: type[BaseModel], above: tuple[str, ...] = ()) -> Iterator[OptionField]:
    """The options of `model`, in the order of its fields; the fields of a nested model are options of their own."""
    for name, field in model.model_fields.items():
        if isinstance(field.annotation, type) and issubclass(field.annotation, Settings):
            yield from option_fields(field.annotation, (*above, name))
            continue
        own = next((one for one in field.metadata if isinstance(one, Option)), Option())
        unit = next((unit for unit in UNITS if name.endswith(unit)), "")
        option_name = own.name or name.removesuffix(unit).replace("_", "-")
        yield OptionField((*above, name), field, model, option_name, own.metavar or UNITS.get(unit, ""), own)


def option_words(model: type[BaseModel], values: Mapping[str, Any]) -> list[str]:
    """`values`, by field of `model`, as words of a command line: {"every_s": 0.5} is ["--every", "0.5"]."""
    words: list[str] = []
    for option in option_fields(model):
        value: Any = values
        for name in option.path:
            value = value.get(name) if isinstance(value, Mapping) else getattr(value, name, None)
        if isinstance(value, bool):
            words += [f"--{option.flag(value)}"] if value != option.field.default else []
        elif value is not None:
            texts = option.own.texts or _texts_of
            for text in texts(value):
                words += [text] if option.own.argument else [f"--{option.name}", text]
    return words


def _texts_of(value: Any) -> list[str]:
    return [_text_of(one) for one in (value if isinstance(value, list | tuple) else [value])]


def _text_of(value: Any) -> str:
    """A value as its option reads it: settings as KEY=VALUE,..."""
    if isinstance(value, BaseModel):
        value = value.model_dump(mode="json", by_alias=True, exclude_unset=True)
    if isinstance(value, Mapping):
        return ",".join(f"{key}={one}" for key, one in value.items())
    return f"{value:.12g}" if isinstance(value, float) else str(value)


def from_text(parse: Callable[[str], Any]) -> BeforeValidator:
    """In the annotation of a field: text is read by `parse`, which may raise GridtrackError; other values stay."""
    return BeforeValidator(lambda value: parse(value) if isinstance(value, str) else value)


def from_texts(parse: Callable[[str], tuple[str, Any]]) -> BeforeValidator:
    """In the annotation of a mapping: a list of texts is read by `parse`, each as a key and a value."""
    return BeforeValidator(lambda value: dict(map(parse, value)) if isinstance(value, list | tuple) else value)


def seconds(text: str) -> float:
    """`2.5s` or `2.5` in seconds. Raises ConfigurationError."""
    try:
        return float(text.removesuffix("s"))
    except ValueError:
        raise ConfigurationError(f"'{text}': expected seconds, such as 2.5s") from None


Seconds = Annotated[float, from_text(seconds)]
"""Seconds, also as text: 2.5 or "2.5s"."""
