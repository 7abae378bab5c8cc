"""Scripts, data and styles inside the page, and the policy that lets a browser run only these.

A script is an ES module in `reports/assets`. To add one:

1. Write `assets/NAME.js`. It imports from its neighbours with lines such as `import { make } from "./drawing.js";`,
   and exports with `export` before a declaration. Names at the top level are unique over all modules.
2. Import it in `main.js`, and call its exports there.
3. Its data of the run is one key of the page's data: add it in `page_data.py`, and read it from `pageData` of
   `page_data.js`. Texts of a run go into the page with `textContent`, never as HTML.

At render time `main.js` and its imports are joined into one inline module, imports first. The run changes only the
data, so the hash of the script changes only with the package. Set a style by a class, or by a property of
`element.style`: the policy refuses `style` attributes in HTML.
"""

from __future__ import annotations

import base64
import hashlib
import json
import re
import zlib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from markupsafe import Markup

ASSETS = Path(__file__).parent / "assets"
MAIN_SCRIPT = "main.js"
_IMPORT = re.compile(r'^import \{[^}]*\} from "\./([a-z_]+\.js)";\n', re.MULTILINE)
_DECLARED = re.compile(r"^(?:async )?(?:function|class|const|let) (\w+)", re.MULTILINE)
_DECLARED_BESIDE = re.compile(r"^(?:const|let) .*$", re.MULTILINE)
_CONSTANT = re.compile(r", ([A-Z][A-Z0-9_]*) = ")
_EXPORT = re.compile(r"^export (?=(?:async )?(?:function|class|const|let)\b)", re.MULTILINE)


def joined_script(folder: Path = ASSETS) -> Markup:
    """`main.js` of `folder` and its imports as one module, each once and after its own imports.

    Raises ValueError for imports in a circle or of another form than described above, and for a name declared twice.
    """
    parts: dict[str, str] = {}
    _add_module(folder, MAIN_SCRIPT, (), parts)
    script = "\n".join(parts.values())
    if re.search(r"^(import|export)\b", script, re.MULTILINE) or re.search(r"</script|<!--", script, re.IGNORECASE):
        raise ValueError(f"{folder}: an import or export of another form, or the end of a script element, in a module")
    names = _DECLARED.findall(script)
    names += [name for line in _DECLARED_BESIDE.findall(script) for name in _CONSTANT.findall(line)]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise ValueError(f"{folder}: declared in two modules: {', '.join(twice)}")
    return Markup(script)  # files of this package, no text of a run


def _add_module(folder: Path, name: str, above: tuple[str, ...], parts: dict[str, str]) -> None:
    if name in above:
        raise ValueError(f"{' imports '.join((*above, name))}: modules in a circle")
    text = (folder / name).read_text("utf-8")
    for needed in _IMPORT.findall(text):
        if needed not in parts:
            _add_module(folder, needed, (*above, name), parts)
    parts[name] = _EXPORT.sub("", _IMPORT.sub("", text))


def data_in_page(data: Any) -> Markup:
    """`data` as JSON, deflated, in base64: a third of its size, and no text in it can end the element."""
    packed = zlib.compress(json.dumps(data, separators=(",", ":"), allow_nan=False).encode(), 6)
    return Markup(base64.b64encode(packed).decode())


def json_in_page(data: Any) -> Markup:
    """`data` as JSON, in which no text can end the element, for data that is already deflated inside."""
    return Markup(json.dumps(data, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c"))


def policy_of(scripts: Iterable[str], styles: Iterable[str]) -> str:
    """The Content-Security-Policy that allows these inline scripts and styles, and no request."""
    return (
        f"default-src 'none'; img-src data:; script-src {_hashes(scripts)}; style-src {_hashes(styles)};"
        " base-uri 'none'; form-action 'none'"
    )


def _hashes(texts: Iterable[str]) -> str:
    return " ".join(f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'" for text in texts)
