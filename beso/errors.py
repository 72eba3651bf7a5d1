"""Exceptions for what a user can mend."""

from typing import Final

LONGEST: Final = 2000  # characters of a message


class UserError(Exception):
    """Something outside the program is wrong. The message is one line: what is wrong, where, and what is allowed.

    It stays one line, and not a long one, where a name in it came from a file.
    """

    def __init__(self, message: str) -> None:
        line = " ".join(message.splitlines())
        super().__init__(line if len(line) <= LONGEST else f"{line[:LONGEST]}...")


class CannotDrawError(UserError):
    """This machine cannot render pictures; all but films works without them."""
