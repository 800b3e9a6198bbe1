"""The one line a person reads when something from outside is wrong."""

from __future__ import annotations


class BadInput(ValueError):
    """
    Something from outside (a file, an argument, a parameter) cannot be used.

    where: the file or the caller; key: the place in it ('' when it is the whole);
    problem: what is wrong; mend: what to do about it. str() is one printable line.
    """

    def __init__(self, where: object, key: str, problem: str, mend: str) -> None:
        self.where = str(where)
        self.key = key
        self.problem = problem
        self.mend = mend
        parts = (self.where, _cut(key, 120), _cut(problem, 300))
        place = ': '.join(part for part in parts if part)
        line = ' '.join((f'{place}; {_cut(mend, 400)}' if mend else place).split())
        super().__init__(''.join(c if c.isprintable() else '?' for c in line))

    def __reduce__(self) -> tuple[type, tuple[str, ...]]:
        """Let it come back from another process."""
        return type(self), (self.where, self.key, self.problem, self.mend)


def check_text(value: object, where: object, key: str) -> str:
    """Return the text; raise BadInput unless it can stand in a log line."""
    if not isinstance(value, str) or not value.isprintable():
        raise BadInput(where, key, f'{shown(value)} is not a text of one line',
                       'give printable characters, in quotes')
    return value


def reason(error: Exception) -> str:
    """Return why a file could not be opened, read or written, in the system's words."""
    if type(error) is ValueError:  # of a name; each Python words it otherwise
        return 'embedded null byte'
    return getattr(error, 'strerror', None) or str(error)


def _cut(text: str, limit: int) -> str:
    return text if len(text) <= limit else text[:limit - 3] + '...'


def shown(value: object, limit: int = 60) -> str:
    """Return a value quoted for an error line, cut to `limit` characters."""
    text = repr(value[:limit + 1]) if isinstance(value, (str, bytes)) else repr(value)
    return _cut(text, limit)
