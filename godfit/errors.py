"""What is said to the user: InputError, whose message is printed, and the remarks of a result.

This file imports nothing: see ``godfit/__init__.py``.
"""

LIKELIHOOD_INCOMPLETE = (
    "{}: expected a target whose only errors are noise and rounding, got one that was compressed "
    "or whose light pass was stored smaller; the errors quoted already allow for that"
)
"""Message with the name of a study that needs the likelihood, refused where the quoted errors were
simulated because the likelihood does not model compression or upsampling."""


LONGEST_SHOWN = 200
"""Characters of a name or a value that a message shows: whoever made a file chose its length."""


def plain(text: str) -> str:
    """One line that any terminal prints as it is: control characters are escaped, and words of
    more than ``LONGEST_SHOWN`` characters are cut."""
    line = " ".join(text.splitlines())
    if not line.isprintable():
        line = "".join(
            c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in line
        )
    if len(line) <= LONGEST_SHOWN:
        return line
    return " ".join(
        word if len(word) <= LONGEST_SHOWN else word[:LONGEST_SHOWN] + "..."
        for word in line.split(" ")
    )


def shown(value: object) -> str:
    """A value as messages show it, cut after ``LONGEST_SHOWN`` characters."""
    try:
        text = repr(value)
    except (ValueError, RecursionError):
        # A number of thousands of digits, or brackets nested as deeply.
        return f"a {type(value).__name__} too long to show"
    return text if len(text) <= LONGEST_SHOWN else text[:LONGEST_SHOWN] + "..."


class Remark(str):
    """A note or a warning for the user: a sentence, with a ``code`` by which a program tells it
    from others, in whatever words it comes."""

    code: str

    def __new__(cls, text: str, code: str) -> "Remark":
        remark = super().__new__(cls, text)
        remark.code = code
        return remark

    @property
    def option(self) -> "str | None":
        """The first option of the command line that the sentence names."""
        words = (word.strip("(),.;:`'") for word in self.split())
        return next((word.split("=")[0] for word in words if word.startswith("--")), None)


class InputError(ValueError):
    """One line that states what was expected, what was got and what to do. It is a ValueError.

    >>> import godfit
    >>> godfit.fit("frame.png", mask="mask.png", shader="babilon")
    Traceback (most recent call last):
    ...
    godfit.errors.InputError: shader: expected one of ...; did you mean 'babylon'?
    """

    def __init__(self, message: object) -> None:
        super().__init__(plain(str(message)))

    @staticmethod
    def within(error: Exception) -> "InputError | None":
        """The InputError that compiled code raised and JAX wrapped in ``error``; None if there is
        none."""
        _, found, rest = str(error).partition("InputError: ")
        return InputError(rest.splitlines()[0]) if found else None
