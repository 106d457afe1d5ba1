"""What README.md and docs/ refer to is there."""

import re
from pathlib import Path

import pytest

import godfit

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]


def test_two_commands():
    # .ci/run runs these two and no others.
    blocks = re.findall(r"^```(\w*)\n(.*?)^```$", README, flags=re.MULTILINE | re.DOTALL)
    assert [language for language, _ in blocks] == ["sh", "sh"]
    assert [len(command.splitlines()) for _, command in blocks] == [1, 1]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links(page):
    text = page.read_text(encoding="utf-8")
    for target in re.findall(r"\]\(([^)]+)\)", text):
        file, _, section = target.partition("#")
        linked = page.parent / file if file else page
        assert linked.is_file(), target
        if section:
            headings = re.findall(r"^#+ (.+)$", linked.read_text(encoding="utf-8"), re.MULTILINE)
            assert section in [re.sub(r"[^a-z0-9]+", "-", h.lower()) for h in headings], target


QUESTIONS = {
    "which shader am i": "shaders.md",
    "my shader is not listed": "howto.md",
    "my mask is white where objects are": "howto.md",
    "it says not converged": "troubleshooting.md",
    "what is density": "concepts.md",
    "how do i get the mask out of babylon": "engines.md",
    "how do i get a fit into babylon": "engines.md",
    "how do i fit 500 frames": "howto.md",
    "what do the errors mean": "concepts.md",
    "how do i cite": "howto.md",
}
"""What a newcomer asks, and the page that answers."""


def test_questions_are_answered_within_two_clicks():
    assert "](docs/index.md)" in README
    table = re.findall(
        r"^\| (.+?) \| (.+?) \|$", (ROOT / "docs/index.md").read_text(), re.MULTILINE
    )
    rows = {question.lower().rstrip("?"): answer for question, answer in table}
    for question, page in QUESTIONS.items():
        (answer,) = [a for asked, a in rows.items() if asked.startswith(question)]
        assert f"]({page}" in answer, question


def test_names_of_the_example():
    names = set(re.findall(r"\bgodfit\.(\w+)\(", README))
    assert {"fit", "Mitchell", "rasterise"} <= names
    assert names <= set(godfit.__all__)
