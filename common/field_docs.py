"""The docstrings of the fields of models: the help of options, and the descriptions in JSON Schemas.

pydantic can collect them itself (`use_attribute_docstrings`), but does so when a class is made: a quarter of a second
in every process, of which few ever show a description.
"""

from __future__ import annotations

import ast
import inspect
import sys
from collections.abc import Iterator
from functools import cache
from typing import Any

from pydantic import BaseModel
from pydantic.json_schema import GenerateJsonSchema


@cache
def field_docs(model: type[BaseModel]) -> dict[str, str]:
    """The docstrings of the fields of `model` and of its bases, by the name of the field.

    Empty where the source of a class cannot be read.

    >>> from gridtrack.common.notices import Notice
    >>> field_docs(Notice)["row"]
    'The label of the row.'
    """
    docs: dict[str, str] = {}
    for base in reversed(model.__mro__):
        if issubclass(base, BaseModel) and base is not BaseModel:
            docs = {name: text for name, text in docs.items() if name not in inspect.get_annotations(base)}
            docs |= _classes_of(base.__module__).get(base.__qualname__, {})
    return docs


def documented_schema(model: type[BaseModel], **options: Any) -> dict[str, Any]:
    """`model.model_json_schema(**options)` with the docstrings of the fields as descriptions."""
    return model.model_json_schema(schema_generator=_WithDocs, **options)


class _WithDocs(GenerateJsonSchema):
    """Adds the docstring of each field that has no description."""

    def model_schema(self, schema: Any) -> dict[str, Any]:
        made = super().model_schema(schema)
        model: type[BaseModel] = schema["cls"]
        docs = field_docs(model)
        for name, field in model.model_fields.items():
            written = made.get("properties", {}).get((self.by_alias and field.serialization_alias) or name)
            if written is not None and name in docs:
                written.setdefault("description", docs[name])
        return made


@cache
def _classes_of(module: str) -> dict[str, dict[str, str]]:
    """The docstrings of the fields of each class of a module, by the qualified name of the class."""
    try:
        source = inspect.getsource(sys.modules[module])
    except (KeyError, OSError, TypeError):
        return {}
    return dict(_classes(ast.parse(source), ""))


def _classes(node: ast.AST, above: str) -> Iterator[tuple[str, dict[str, str]]]:
    for child in ast.iter_child_nodes(node):
        name = f"{above}{getattr(child, 'name', '')}"
        if isinstance(child, ast.ClassDef):
            yield name, dict(_documented(child))
            yield from _classes(child, f"{name}.")
        elif isinstance(child, ast.FunctionDef):
            yield from _classes(child, f"{name}.<locals>.")
        elif isinstance(child, ast.stmt):
            yield from _classes(child, above)


def _documented(owner: ast.ClassDef) -> Iterator[tuple[str, str]]:
    """Each field that a string follows, and the string."""
    for field, after in zip(owner.body, owner.body[1:], strict=False):
        match field, after:
            case ast.AnnAssign(target=ast.Name(id=name)), ast.Expr(value=ast.Constant(value=str(text))):
                yield name, inspect.cleandoc(text)
