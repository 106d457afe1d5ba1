"""Every word of docs/glossary.md is defined where the glossary has it, and has one meaning."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
ENTRY = re.compile(r"- \*\*(.+?)\*\*: (.+) \(`(godfit/[^`]+\.py)`, `(\w+)`\)")
GLOSSARY = (ROOT / "docs" / "glossary.md").read_text(encoding="utf-8")
ITEMS = [
    " ".join(item.split()) for item in re.findall(r"^- .*(?:\n .*)*", GLOSSARY, flags=re.MULTILINE)
]


@pytest.mark.parametrize("item", ITEMS, ids=lambda item: item.split("**")[1])
def test_defined(item):
    found = ENTRY.fullmatch(item)
    assert found, "expected - **word**: One sentence. (`godfit/file.py`, `symbol`)"
    word, meaning, file, symbol = found.groups()
    assert len(re.findall(r"[.!?;:](?=\s|$)", meaning)) == 1, f"{word}: expected one sentence"
    source = ROOT / file
    assert source.is_file(), f"{word}: expected {file}, which is not there"
    text = source.read_text(encoding="utf-8")
    assert re.search(rf"\b{symbol}\b", text), f"{word}: {file} does not contain {symbol}"


def test_one_meaning_a_word():
    words = [item.split("**")[1] for item in ITEMS]
    assert len(words) >= 40
    assert sorted(words) == sorted(set(words))
