"""InputError, the one exception whose message is printed to the user.

This file imports nothing: see ``godfit/__init__.py``.
"""

LIKELIHOOD_INCOMPLETE = (
    "{}: expected a target whose only errors are noise and rounding, got one that was compressed "
    "or whose light pass was stored smaller; the errors quoted already allow for that"
)
"""Message with the name of a study that needs the likelihood, refused where the quoted errors were
simulated because the likelihood does not model compression or upsampling."""


class InputError(ValueError):
    """One line that states what was expected, what was got and what to do."""

    def __init__(self, message: object) -> None:
        super().__init__(" ".join(str(message).splitlines()))

    @staticmethod
    def within(error: Exception) -> "InputError | None":
        """The InputError that compiled code raised and JAX wrapped in ``error``; None if there is
        none."""
        _, found, rest = str(error).partition("InputError: ")
        return InputError(rest.splitlines()[0]) if found else None
