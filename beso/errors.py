"""Exceptions for what a user can mend."""


class UserError(Exception):
    """Something outside the program is wrong. The message is one line: what is wrong, where, and what is allowed."""


class CannotDrawError(UserError):
    """This machine cannot render pictures; all but films works without them."""
