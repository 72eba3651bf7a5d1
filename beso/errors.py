"""The one exception for mistakes that a user can make and mend."""


class UserError(Exception):
    """Something outside the program is wrong. The message is one line: what is wrong, where, and what is allowed."""
