"""Words that the package, its tests and its pages do not use, and their replacements."""

import re

LEFT_OUT = {
    r"tells?|told|says?|said": "reports, returns, prints, records, gives; states (of a file or a person)",
    r"stands?(?!-alone)|stood|standing": "is, lies at, is located at, is mounted; represents",
    r"beside": "next to, with, compared with, in addition to",
    r"held (?:against|to)": "compared with, checked against",
    r"asks?|asked(?! questions)": "requests, requested, specified",
    r"so many|so manieth": "count of, number of, every n-th",
    r"shall": "must, will",
    r"a hair": "tolerance, rounding error",
    r"anew": "again, from scratch",
    r"for ever": "forever, until the process ends",
    r"whatever|whoever": "regardless of, any",
    r"lessens?": "reduces",
    r"hangs? on": "depends on",
    r"cells differ|differing cells": "non-uniform sheet",
    r"equal cells": "uniform sheet, identical cells",
    r"strangers?(?:'s)?": "untrusted file",
    r"came back|comes back": "was measured, is returned",
    r"stand-ins?": "substitute, representative cell",
    r"overheard": "hash while reading",
    r"worked out|works out": "computed, derived",
    r"one and the other": "both, all, each",
}
"""Words, as regular expressions → what is written instead."""

ADDRESSED = r"asks?|says?"
"""Words that a message may use, as in "ask to overwrite" and "the manifest says"."""

ANY = re.compile(rf"\b(?:{'|'.join(LEFT_OUT)})\b", re.IGNORECASE)
"""Any of the words: most files and texts have none, and need no closer look."""
