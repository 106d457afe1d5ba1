"""The one kind of error that a user is meant to see."""

from __future__ import annotations

# Of what only the likelihood knows, for a fit whose errors come from elsewhere.
SIMULATED = (
    "{}: expected a target that the likelihood alone explains, got one that was compressed or "
    "whose light pass was stored smaller; the errors quoted already allow for that"
)


class InputError(ValueError):
    """One line that says what was expected, what was got and what to do."""

    def __init__(self, message: object) -> None:
        super().__init__(" ".join(str(message).splitlines()))

    @staticmethod
    def within(error: Exception) -> InputError | None:
        """The InputError that was raised inside compiled code and came out as another, if any."""
        _, found, rest = str(error).partition("InputError: ")
        return InputError(rest.splitlines()[0]) if found else None
