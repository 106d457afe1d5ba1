"""README, docs, help texts and messages are plain English.

Three rules:

- No sentence begins with "Of".
- No sentence is longer than 35 words. A sentence ends at . ! ? : or ; and at the end of a
  paragraph, a heading or an item of a list. Code, code blocks and tables are skipped.
- No verb of perception stands for a computation. A program computes, solves, rejects and keeps; it
  is not told, asked, seen or understood. "Read" is for what is stored: a file, a mask, a texture.

Checked are README.md and docs/*.md, every command's help, and the strings of godfit/ that reach
users: those of exceptions and warnings, stages of progress, and templates of messages.
"""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import click
import pytest

from godfit.__main__ import cli

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
SOURCES = sorted((ROOT / "godfit").rglob("*.py"))
LONGEST = 35
"""Words of a sentence, at most: two lines of 100 columns."""
PERCEPTION = (
    "tell", "tells", "told", "telling", "ask", "asks", "asked", "asking", "sees", "saw", "seen",
    "seeing", "think", "thinks", "thought", "look", "looks", "looked", "looking", "understand",
    "understands", "understood", "knows", "knew", "believe", "believes", "believed", "notices",
    "noticed", "hears", "heard",
)  # fmt: skip
"""Verbs that take a person. "See docs/" is addressed to one, and "known" is an ordinary adjective
of statistics: neither is here."""
READ = ("read", "reads", "reading")
STORED = (
    "file", "files", "image", "images", "format", "formats", "png", "jpeg", "tiff", "exr", "npy",
    "toml", "json", "gltf", "mesh", "meshes", "video", "frame", "frames", "cache", "memory", "disk",
    "byte", "bytes", "mask", "texture", "texel", "texels", "pixel", "pixels", "tap", "taps", "pass",
    "shader", "shaders", "code", "docs", "page", "section",
)  # fmt: skip
"""Nouns beside one of which "read" moves what is stored, or has a person with a page."""
ALLOWED = (
    ("cannot be read (x)", "a file whose name stands before the colon"),
    ("data window was read", "the data window is a part of an OpenEXR file"),
)
"""Phrases, in lower case, that the third rule allows, and why."""


def paragraphs(markdown: str) -> Iterator[str]:
    """The prose of a page: paragraphs, headings and items of lists, without code and tables."""
    fenced, block = False, []
    for line in [*markdown.splitlines(), ""]:
        fence = line.lstrip().startswith("```")
        fenced ^= fence
        text = line.strip()
        item = re.match(r"([-*]|\d+\.)\s+", text)
        heading = text.startswith("#")
        # A line that goes on with an item is indented too; code comes after a blank line.
        code = fenced or fence or (line.startswith("    ") and not block and not item)
        starts = code or not text or text.startswith("|") or item or heading
        if starts and block:
            yield " ".join(block)
            block = []
        if code or not text or text.startswith("|"):
            continue
        if heading:
            yield text.lstrip("# ")
        else:
            block.append(text[item.end() :] if item else text)


def prose(text: str) -> str:
    """Markdown without its marks. Code and addresses become the word "x"."""
    text = re.sub(r"(`+)[^`]+\1", "x", text)
    text = re.sub(r"!?\[([^\]]*)\]\([^)]*\)", r"\1", text)
    return re.sub(r"https?://\S+", "x", text).replace("**", "")


def sentences(text: str) -> list[str]:
    """The sentences of a paragraph. A stop ends one before a blank, so that .5 does not."""
    ended = re.split(r"(?<=[.!?:;])[\"')\]]*\s+", " ".join(prose(text).split()))
    return [sentence for sentence in ended if re.search(r"\w", sentence)]


def words(sentence: str) -> list[str]:
    """The words of a sentence, numbers among them."""
    return [word for word in sentence.split() if re.search(r"\w", word)]


def faults(text: str) -> list[str]:
    """A line for every rule that a sentence of ``text`` breaks: what is wrong, and the sentence."""
    found = []
    for sentence in sentences(text):
        if len(words(sentence)) > LONGEST:
            found.append(f"{len(words(sentence))} words: {sentence}")
        if re.match(r"\W*of\b", sentence, re.IGNORECASE):
            found.append(f"begins with 'Of': {sentence}")
        plain = sentence.lower()
        for phrase, _ in ALLOWED:
            plain = plain.replace(phrase, "")
        single = set(re.findall(r"[a-z]+", plain))
        found += [f"'{verb}' of a computation: {sentence}" for verb in PERCEPTION if verb in single]
        if single & set(READ) and not single & set(STORED):
            found.append(f"'read' of what is not stored: {sentence}")
    return found


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("Of 20 pictures 18 were found.", "begins"),
        ("It is measured: of 20 pictures 18 were found.", "begins"),
        ("First. (Of these three are left.)", "begins"),
        (f"It is{' very' * LONGEST} long.", "words"),
        ("The mask as it was understood.", "understood"),
        ("Noise is asked of all pixels.", "asked"),
        ("The search is told `nothing`.", "told"),
        ("Density is read from the spacing of bands.", "read"),
        ("- a first item\n- The minimum is looked\n  for.", "looked"),
        ("# What the fit knows", "knows"),
        ("|a|\n|-|\n\nThe answer is seen.", "seen"),
    ],
)
def test_bad_sentences(text, fault):
    found = [line for block in paragraphs(text) for line in faults(block)]
    assert len(found) == 1, found
    assert fault in found[0]


@pytest.mark.parametrize(
    "text",
    [
        "The shader reads the mask; PNG files are read without losing bits.",
        f"It is{' very' * 30} long: it is{' very' * 30} long.",
        "Errors are .5, 1.5 and 2 levels of 255. Half of them cover.",
        "Run `godfit told asked seen`; see [the tutorial](docs/of-told.md).",
        "Look here:\n\n    of told asked seen\n".replace("Look", "Run"),
        "```\nof told asked seen\n```",
        "| of | told | asked |",
        "The variance is known, and the light is found.",
    ],
)
def test_good_sentences(text):
    assert [line for block in paragraphs(text) for line in faults(block)] == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_pages(page):
    text = page.read_text(encoding="utf-8")
    assert [line for block in paragraphs(text) for line in faults(block)] == []


def commands(group: click.Group, name: str) -> Iterator[tuple[str, click.Command]]:
    """(name, command) of a group and all below it."""
    yield name, group
    for child in group.commands.values():
        below = f"{name} {child.name}"
        if isinstance(child, click.Group):
            yield from commands(child, below)
        else:
            yield below, child


@pytest.mark.parametrize(("name", "command"), list(commands(cli, "godfit")))
def test_help(name, command):
    shown = command.to_info_dict(click.Context(command, info_name=name))
    texts = (command.help or "").split("\n\n")
    texts += [option["help"] for option in shown["params"] if option.get("help")]
    assert [line for text in texts for line in faults(text)] == []


SPEAKERS = {
    "InputError", "ValueError", "UsageError", "BadParameter", "warn", "echo", "progress", "report",
    "say", "Suspect",
}  # fmt: skip
"""Functions and exceptions whose strings reach users."""
CARRIERS = {"message", "words", "note", "notes", "remarks", "doubts", "said", "lines", "what"}
"""Variables and arguments that hold such strings."""
RETURNERS = {"summary", "html", "sentence", "_message", "_sentences", "_remark"}
"""Functions that return them."""


def messages(source: str) -> Iterator[tuple[int, str]]:
    """(line, text) of a module's strings that reach users, what is filled in written as "x". A word
    or two are a name or a key, and left out."""
    found: dict[ast.expr, None] = {}
    for node in ast.walk(ast.parse(source)):
        for spoken in spoken_in(node):
            found |= dict.fromkeys(strings(spoken))
    for node in found:
        parts = node.values if isinstance(node, ast.JoinedStr) else [node]
        text = "".join(str(p.value) if isinstance(p, ast.Constant) else "x" for p in parts)
        text = re.sub(r"\{[^}]*\}", "x", text)
        if len(words(text)) > 2:
            yield node.lineno, text


def spoken_in(node: ast.AST) -> list[ast.expr]:
    """The expressions of ``node`` whose strings reach users."""
    if isinstance(node, ast.Call):
        name = getattr(node.func, "attr", getattr(node.func, "id", ""))
        arguments = {keyword.arg: keyword.value for keyword in node.keywords}
        if name.lstrip("_") in SPEAKERS:
            return [*node.args, *arguments.values()]
        if name == "append" and getattr(getattr(node.func, "value", None), "id", "") in CARRIERS:
            return node.args
        return [value for key, value in arguments.items() if key in CARRIERS]
    if isinstance(node, (ast.Assign, ast.AnnAssign, ast.AugAssign)) and node.value is not None:
        targets = node.targets if isinstance(node, ast.Assign) else [node.target]
        names = {n.id for target in targets for n in ast.walk(target) if isinstance(n, ast.Name)}
        # A constant that holds words is a template of messages; one that is built by calls is not.
        template = any(name.isupper() for name in names) and not isinstance(node.value, ast.Call)
        return [node.value] if names & CARRIERS or template else []
    if isinstance(node, ast.FunctionDef) and node.name in RETURNERS:
        return [n.value for n in ast.walk(node) if isinstance(n, ast.Return) and n.value]
    return []


def strings(node: ast.AST) -> Iterator[ast.expr]:
    """The strings of an expression, formatted ones as a whole. A tuple of calls is a table of
    settings, and no message."""
    constant = isinstance(node, ast.Constant) and isinstance(node.value, str)
    if constant or isinstance(node, ast.JoinedStr):
        yield node
    elif not isinstance(node, ast.Tuple) or not any(isinstance(n, ast.Call) for n in node.elts):
        for child in ast.iter_child_nodes(node):
            yield from strings(child)


MODULES = [pytest.param(p, id=p.relative_to(ROOT).as_posix()) for p in SOURCES]


@pytest.mark.parametrize("path", MODULES)
def test_messages(path):
    found = [
        f"line {line}: {fault}"
        for line, text in messages(path.read_text(encoding="utf-8"))
        for fault in faults(text)
    ]
    assert found == []


def test_messages_are_found():
    source = '''
WORDS = {"a": "the residual is {x} and {y} " "levels"}
TABLE = (Row("of the ray", 1),)
def f(n):
    """Of a docstring nothing is said."""
    raise InputError(f"mask: expected {n} pixels, " f"got {n:.2f}; scale it")
'''
    assert sorted(messages(source)) == [
        (2, "the residual is x and x levels"),
        (6, "mask: expected x pixels, got x; scale it"),
    ]
