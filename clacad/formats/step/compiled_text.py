"""Statements of a STEP file's text, cut up in one compiled pass; imported only for large files.

Entities of frequent types are reduced to numbers. Every other statement is left to the reader of single
statements, and so is a frequent one whose numbers have an unusual form.
"""

from __future__ import annotations

import numpy as np

from clacad.base.compiled import entry, exact, multiply_add
from clacad.base.types import Bytes, Floats, Ints, Words

POINT, RARE = 0, -1
"""Kind of points, the first of the table, and of statements that are left to the reader of single ones."""

FORWARD, BACKWARD = 1, 2
"""Flags of a statement: it contains .T., or .F."""

TENS = np.array([10.0**k for k in range(23)])
MOST = np.uint64(1 << 53)
"""Exact powers of ten, and the integer up to which all are exact: a quotient of both is rounded once."""

NARROW = 2.0**-40
"""Relative error of the second part of a quotient, much more than that of its arithmetic."""

HASH_SEED, HASH_FACTOR = np.uint64(0xCBF29CE484222325), np.uint64(0x100000001B3)
"""Of the hash of a name (Fowler, Noll and Vo, 64 bits)."""

QUOTE, HASH, OPEN, CLOSE, SEMICOLON, EQUAL, DOT, PLUS, MINUS, COMMA = np.frombuffer(b"'#();=.+-,", np.uint8)
LETTER_E, SMALL_E, LETTER_T, LETTER_F, LINE = np.frombuffer(b"EeTF_", np.uint8)
DIGIT = 48
"""Code of the digit 0."""

ZERO, NINE, LETTER_A, LETTER_Z, BLANK = np.frombuffer(b"09AZ ", np.uint8)


def name_hash(name: str) -> int:
    """Hash of the name of a type, as the kernel computes it."""
    value = int(HASH_SEED)
    for letter in name.encode("ascii"):
        value = ((value ^ letter) * int(HASH_FACTOR)) % (1 << 64)
    return value


@exact
def after_blanks(text: Bytes, at: int, end: int) -> int:
    """Index of the first character that is no blank or line break."""
    while at < end and text[at] <= BLANK:
        at += 1
    return at


@exact
def statement_end(text: Bytes, at: int, end: int) -> int:
    """Index of the semicolon that ends the statement at `at`, −1 where the text ends before it."""
    while at < end:
        letter = text[at]
        if letter == SEMICOLON:
            return at
        if letter == QUOTE:
            at += 1
            while at < end and text[at] != QUOTE:
                at += 1
        at += 1
    return -1


@exact
def head(text: Bytes, at: int, end: int, table: Words) -> tuple[int, int, int]:
    """Number of the entity, kind, and index behind the name of its type; kind RARE for anything else."""
    at = after_blanks(text, at, end)
    if at >= end or text[at] != HASH:
        return 0, RARE, at
    at += 1
    number, first = 0, at
    while at < end and ZERO <= text[at] <= NINE:
        number = 10 * number + (int(text[at]) - DIGIT)
        at += 1
    if at == first or at - first > 18:
        return 0, RARE, at
    at = after_blanks(text, at, end)
    if at >= end or text[at] != EQUAL:
        return 0, RARE, at
    at = after_blanks(text, at + 1, end)
    value = HASH_SEED
    while at < end and (LETTER_A <= text[at] <= LETTER_Z or ZERO <= text[at] <= NINE or text[at] == LINE):
        value = (value ^ np.uint64(text[at])) * HASH_FACTOR
        at += 1
    for kind in range(len(table)):
        if table[kind] == value:
            return number, kind, at
    return number, RARE, at


@exact
def one_number(text: Bytes, at: int, end: int, values: Floats, row: int) -> int:
    """Read a number into values[row], rounded once; index behind it, −1 where that is not certain."""
    negative = text[at] == MINUS
    if negative or text[at] == PLUS:
        at += 1
    first = at
    digits, whole, power = 0, np.uint64(0), 0
    while at < end and ZERO <= text[at] <= NINE:
        whole = np.uint64(10) * whole + np.uint64(text[at] - ZERO)
        digits += int(whole > 0)
        at += 1
    if at == first:
        return -1
    if at < end and text[at] == DOT:
        at += 1
        while at < end and ZERO <= text[at] <= NINE:
            whole = np.uint64(10) * whole + np.uint64(text[at] - ZERO)
            digits += int(whole > 0)
            power -= 1
            at += 1
    if at < end and (text[at] == LETTER_E or text[at] == SMALL_E):
        at += 1
        sign = 1
        if at < end and (text[at] == PLUS or text[at] == MINUS):
            sign = -1 if text[at] == MINUS else 1
            at += 1
        given, begun = 0, at
        while at < end and ZERO <= text[at] <= NINE and given < 1000:
            given = 10 * given + (int(text[at]) - DIGIT)
            at += 1
        if at == begun:
            return -1
        power += sign * given
    if digits > 18 or power > 22 or power < -22:
        return -1
    value = np.float64(whole)
    if whole <= MOST or power == 0:
        value = value * TENS[power] if power >= 0 else value / TENS[-power]
    elif power > 0:
        return -1
    else:  # the quotient in two parts; the smaller one must not decide how the sum of both is rounded
        ten = TENS[-power]
        high = value / ten
        low = (multiply_add(-high, ten, value) + np.float64(np.int64(whole) - np.int64(value))) / ten
        value = high + low * (1.0 - NARROW)
        if value != high + low * (1.0 + NARROW):
            return -1
    values[row] = -value if negative else value
    return at


@exact
def triple(text: Bytes, at: int, end: int, values: Floats, row: int) -> int:
    """Count of the numbers in the last pair of brackets before `end`, the first three in values[row …].

    −1 where one of them cannot be read here.
    """
    start = end - 1
    while start > at and text[start] != OPEN:
        start -= 1
    count, at = 0, start + 1
    while at < end:
        at = after_blanks(text, at, end)
        if at >= end or text[at] == CLOSE:
            break
        if count == 3:
            return 4
        at = one_number(text, at, end, values, row + count)
        if at < 0:
            return -1
        count += 1
        at = after_blanks(text, at, end)
        if at < end and text[at] == COMMA:
            at += 1
        elif at < end and text[at] != CLOSE:
            return -1
    return count


@exact
def details(text: Bytes, at: int, end: int, references: Ints, row: int) -> tuple[int, int]:
    """References outside strings into references[row …]; index behind the last, and the flags."""
    flags = 0
    while at < end:
        letter = text[at]
        if letter == QUOTE:
            at += 1
            while at < end and text[at] != QUOTE:
                at += 1
        elif letter == HASH:
            number, first = 0, at + 1
            while at + 1 < end and ZERO <= text[at + 1] <= NINE:
                number = 10 * number + (int(text[at + 1]) - DIGIT)
                at += 1
            if at + 1 - first > 18:
                return -1, flags
            if at + 1 > first:
                references[row] = number
                row += 1
        elif letter == DOT and at + 2 < end and text[at + 2] == DOT:
            if text[at + 1] == LETTER_T:
                flags |= FORWARD
            elif text[at + 1] == LETTER_F:
                flags |= BACKWARD
        at += 1
    return row, flags


@entry
def cut(
    text: Bytes, table: Words, entities: Ints, references: Ints, points: Ints, values: Floats
) -> tuple[int, int, int, int]:
    """Cut a text into statements; counts of statements, references and points, and index behind the last.

    text : (n,)
    table : (kinds,). Hashes of the names of frequent types, that of points first.
    entities : (statements, 6)
        Number, kind, flags, index of the first reference, and ends of the statement in the text.
    references : (m,)
    points, values : (p,), (3 p,). Number and coordinates of every point of three.
    """
    count, first, found, at = 0, 0, 0, 0
    while True:
        end = statement_end(text, at, len(text))
        if end < 0:
            return count, first, found, at
        number, kind, behind = head(text, at, end, table)
        row = first
        if kind == POINT:
            many = triple(text, behind, end, values, 3 * found)
            if many == 3:
                points[found] = number
                found += 1
            elif many < 0:
                kind = RARE
        elif kind != RARE:
            row, flags = details(text, behind, end, references, first)
            if row <= first:
                kind = RARE
            entities[count, 2] = flags
        entities[count, 0], entities[count, 1], entities[count, 3] = number, kind, first
        entities[count, 4], entities[count, 5] = at, end
        first = first if kind == RARE else row
        count += 1
        at = end + 1
