"""Modules are joined in the order that they need; data cannot leave its element."""

import base64
import json
import zlib

import pytest

from gridtrack.reports.scripts import data_in_page, joined_script, json_in_page


def write_modules(folder, **texts):
    for name, text in texts.items():
        (folder / f"{name}.js").write_text(text)
    return folder


def test_a_module_stands_once_after_its_imports(tmp_path):
    modules = write_modules(
        tmp_path,
        main='import { b } from "./b.js";\nimport { a } from "./a.js";\nb(a);\n',
        a="export const a = 1;\n",
        b='import {\n  a,\n} from "./a.js";\nexport function b(x) { return x + a; }\n',
    )
    assert joined_script(modules) == "const a = 1;\n\nfunction b(x) { return x + a; }\n\nb(a);\n"


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ('import { a } from "./main.js";\n', "main.js imports main.js: modules in a circle"),
        ('import a from "./a.js";\n', "an import or export of another form"),
        ("export default 1;\n", "an import or export of another form"),
        ('const end = "</SCRIPT>";\n', "the end of a script element"),
        ("const a = 1;\nfunction a() {}\n", "declared in two modules: a"),
        ("const A = 1, SIDE = 2;\nconst SIDE = 3;\n", "declared in two modules: SIDE"),
    ],
)
def test_a_module_that_cannot_be_joined_is_refused(tmp_path, text, why):
    with pytest.raises(ValueError, match=why):
        joined_script(write_modules(tmp_path, main=text))


def test_data_is_read_back_whole_and_holds_no_sign_of_html():
    data = {"</script><script>alert(1)</script>": ["<!-- & \u2028", 0.5, None]}
    embedded = data_in_page(data)
    assert json.loads(zlib.decompress(base64.b64decode(embedded))) == data
    assert not set("<>&\u2028") & set(embedded)


def test_moments_hold_no_sign_that_ends_their_element():
    data = {"</script><!--<script>": ["<b>", "\u2028", 1.5]}
    embedded = json_in_page(data)
    assert json.loads(embedded) == data
    assert "<" not in embedded
