"""Exports of controllers whose names, docstrings and units would end a comment, a text or a tag."""

import io
import json
import re
import shutil
import subprocess
import zipfile
from typing import NamedTuple
from xml.etree import ElementTree

import equinox as eqx
import jax
import jax.numpy as jnp
import pytest

from smajax.control.controllers import AbstractController
from smajax.control.export.c_header import c_header
from smajax.control.export.c_templates import comment_text
from smajax.control.export.fmu.controller_model import controller_model
from smajax.control.export.fmu.pack import pack_fmu
from smajax.control.export.json_document import controller_document
from smajax.control.loop.closed_loop import ClosedLoop
from smajax.files.documents import to_json
from smajax.parameters import parameter

HOSTILE = (
    "*/ #include <stdio.h>", "**// int x;", "*/*/ #error a", "/* /* */", "*//*/ #error b", "a\n#error c", "a\\\n#error d",
    "??/\n#error e", '"; #error f', "%s%n", "\x1b[31m", "\u202e*/", "\ud800", "\x00", "\ufffe", "]]>", "<!--", "--><a/>",
    "</script><script>alert(1)</script>", "<img src=x onerror=alert(1)>", "&lt;&amp;", "'\"><a b='", "<?xml?>", "\u2028",
    "* / x", "*\n/ #error g", "*\t/", "a" * 5000, "µ 温度 é", "{0.__class__} {kind}",
)  # fmt: skip


class State(NamedTuple):
    integral: jax.Array


def hostile_controller(text: str) -> AbstractController:
    """An own controller with a text as its docstring and as the meaning of its gains."""

    class Hostile(AbstractController):
        kp: jax.Array = parameter("u/y", text, 0.0)
        lower: jax.Array = parameter("u", text, default=0.0)
        upper: jax.Array = parameter("u", text, default=1.0)
        period: float = eqx.field(static=True, kw_only=True)

        def reset(self, reference, value):
            return State(jnp.zeros(()))

        def step(self, state, reference, value):
            return state, jnp.clip(self.kp * (reference - value), self.lower, self.upper)

    Hostile.__doc__ = text
    Hostile.__name__ = text.encode("utf-8", "replace").decode().replace("\x00", "") or "x"
    return Hostile(kp=jnp.asarray(2.0), lower=jnp.asarray(0.0), upper=jnp.asarray(1.0), period=0.05)


def test_there_are_thirty_texts():
    assert len(HOSTILE) == len(set(HOSTILE)) == 30


@pytest.mark.parametrize("text", HOSTILE, ids=range(len(HOSTILE)))
def test_no_text_ends_or_begins_a_comment(text):
    comment = comment_text(text)
    assert not any(mark in comment for mark in ("*/", "/*", "\n"))
    comment.encode("utf-8")


@pytest.mark.skipif(shutil.which("cc") is None, reason="there is no C compiler here")
@pytest.mark.parametrize("text", HOSTILE, ids=range(len(HOSTILE)))
def test_the_header_compiles_and_holds_the_program_of_a_plain_one(text, tmp_path):
    headers = {}
    for name, words in (("hostile", text), ("plain", "A plain one.")):
        header = c_header(hostile_controller(words), (words, words), "0", 1.0)
        (tmp_path / f"{name}.h").write_text(header, "utf-8")
        (tmp_path / f"{name}.c").write_text(f'#include "{name}.h"\nint main(void) {{ return 0; }}\n', "utf-8")
        flags = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-Wno-unused-function"]
        subprocess.run(["cc", *flags, "-o", name, f"{name}.c", "-lm"], cwd=tmp_path, check=True)
        headers[name] = re.sub(r"/\*.*?\*/", "", header, flags=re.DOTALL)
    assert headers["hostile"] == headers["plain"]


@pytest.mark.parametrize("text", HOSTILE, ids=range(len(HOSTILE)))
def test_the_fmu_and_the_document_hold_the_text_as_a_text(text):
    pytest.importorskip("pythonfmu")
    loop = ClosedLoop(hostile_controller(text), channel="displacement")
    model = controller_model(loop, ("A", "m"), {"kp": "A/m", "lower": "A", "upper": "A"}, text)
    plain = model._replace(name="plain")
    outlines = []
    for content in (pack_fmu(model), pack_fmu(plain)):
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            description = ElementTree.fromstring(archive.read("modelDescription.xml"))
            page = archive.read("documentation/index.html").decode()
        outlines.append(
            ([(element.tag, sorted(element.attrib)) for element in description.iter()], re.findall("<[^>]*>", page))
        )
    assert outlines[0] == outlines[1]
    document = json.loads(to_json(controller_document(loop, {"kp": "A/m", "lower": "A", "upper": "A"})))
    assert document["schema"].startswith("smajax.")
