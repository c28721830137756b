"""Units of time as files name them: in the name of a column, in brackets, in a comment.

>>> with_unit("timestamp [µs]"), with_unit("t_ns"), with_unit("Zeit (ms)"), with_unit("usec")
(('timestamp', 'us'), ('t', 'ns'), ('zeit', 'ms'), ('t', 'us'))
>>> unit_in("# timestamps are in nanoseconds"), unit_in("# made in 2024")
('ns', None)
"""

from __future__ import annotations

import re

_WORDS = {
    "s": "s sec secs second seconds", "ms": "ms msec msecs millis millisec milliseconds millisecond",
    "us": "us µs usec usecs micros microsec microseconds microsecond",
    "ns": "ns nsec nsecs nanos nanosec nanoseconds nanosecond", "min": "min minute minutes", "h": "h hour hours",
}  # fmt: skip
UNIT_OF = {word: unit for unit, words in _WORDS.items() for word in words.split()}
SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0}
SECONDS_PER = {word: SECONDS[unit] for word, unit in UNIT_OF.items()}
TIMES = ("t", "ts", "time", "times", "timestamp", "timestamps", "time_stamp", "tstamp", "stamp", "event_time")

_UNIT = "|".join(sorted(map(re.escape, UNIT_OF), key=len, reverse=True))
_IN_NAME = re.compile(rf"(.*?)\s*(?:[\[({{<]\s*({_UNIT})\s*[\])}}>]|(?:[_/.\s]|\s+in\s+)({_UNIT}))")
_IN_COMMENT = re.compile(
    rf"(?:^|[#%;,.:|/])\s*(?:units? of )?(?:time\s?stamps?|times?|t|clock)\b[^\w\[(]*"
    rf"(?:units?\b\W*|is\b|are\b|in\b|[\[(=:]|\s)+({_UNIT})(?![-\w])"
    r"(?=\s*[\])}>]?\s*(?:$|[,;|.(\t]|\s(?:t|x|y|p|pol|polarity|col|row|addr|since|from|after|relative|and)\b))"
)


def plain(text: str) -> str:
    """Small letters, one micro sign, no quotes around."""
    return text.strip().strip("'\"").strip().lower().replace("\u03bc", "µ")


def with_unit(name: str) -> tuple[str, str | None]:
    """A column's name without the unit that it states, and that unit (a key of `SECONDS`) or None."""
    name = plain(name)
    if name in UNIT_OF and len(name) > 1:
        return "t", UNIT_OF[name]
    found = _IN_NAME.fullmatch(name)
    return (found[1].strip(), UNIT_OF[found[2] or found[3]]) if found and found[1].strip() else (name, None)


def unit_in(comment: str) -> str | None:
    """The unit that a comment states of times."""
    found = _IN_COMMENT.search(plain(comment).replace("_", " "))
    return UNIT_OF[found[1]] if found else None
