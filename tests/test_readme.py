"""What README.md and docs/ refer to is there."""

import re
from pathlib import Path

import pytest

import godfit

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]


def test_two_commands():
    # .ci/run runs these two and no others.
    blocks = re.findall(r"^```(\w*)\n(.*?)^```$", README, flags=re.MULTILINE | re.DOTALL)
    assert [language for language, _ in blocks] == ["sh", "sh"]
    assert [len(command.splitlines()) for _, command in blocks] == [1, 1]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links(page):
    text = page.read_text(encoding="utf-8")
    for target in re.findall(r"\]\(([^)]+)\)", text):
        file, _, section = target.partition("#")
        linked = page.parent / file if file else page
        assert linked.is_file(), target
        if section:
            headings = re.findall(r"^#+ (.+)$", linked.read_text(encoding="utf-8"), re.MULTILINE)
            assert section in [re.sub(r"[^a-z0-9]+", "-", h.lower()) for h in headings], target


def test_names_of_the_example():
    names = set(re.findall(r"\bgodfit\.(\w+)\(", README))
    assert {"fit", "Mitchell", "rasterise"} <= names
    assert names <= set(godfit.__all__)
