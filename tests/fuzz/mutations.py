"""Seeded mutations of the bytes of files: of any bytes, of lines and words of texts, and inside of compressed parts."""

import io
import struct
import warnings
import zipfile
import zlib
from random import Random

# Numbers that readers of lengths, counts and places do not expect.
_NUMBERS = (0, 1, 2, 7, 8, 15, 127, 128, 255, 256, 32767, 65535, 2**24, 2**31 - 1, 2**31, 2**32 - 1, 2**40, 2**63 - 1)
# Texts that readers of headers and cells do not expect.
_WORDS = (
    b"", b" ", b"nan", b"-inf", b"1e999", b"-0", b"1" * 5000, b"0x10", b"1_000", b"\xc2\xbd", b'"', b"'", b"[", b"]" * 9,
    b"[" * 3000, b"{" * 3000, b"true", b"null", b"time [s]", b"time", b"[]", b"\x00", b"\x1b[31m", b"\xe2\x80\xae", b"\xff",
    b"\r", b"\n", b"\r\n", b",", b";", b"\t", b"=", b"#", b"<!DOCTYPE a>", b"&lt;", b"<row r='9'>", b"1979-05-27", b"12:00:00",
    b"99999999999999999999", b"1.7976931348623157e308", b"5e-324", b"[[a]]", b"a.b.c = 1", b"%s%n", b"{}", b"'''", b'"""',
    b"\xef\xbb\xbf", b"-1", b"1e-400", b"65 degC", b"3 furlong", b"2 m/s", b"0 mm", b"..",
    b"0x" + b"f" * 5000, b"1" * 4000, b"a." * 2000 + b"a = 1", b"{a=" * 500, b"[[" + b"a." * 900 + b"a]]", b"[a.b]", b'["a"]',
    b"{ a = 1 }", b"[1, [2]]", b"0o17", b"inf", b"2024-01-01T00:00:00Z", b'"\\ud800"', b'"\\u202e"', b'"' + b"x" * 9000 + b'"',
    b'"' + b"1" * 5000 + b' mm"', b'"1e99999 K"', b'"1 m^99999"', b'"((((1))))"', b'"1 ' + b"m*" * 3000 + b'm"', b'"../../.."',
    b"/", b"CON", b"true = false",
)  # fmt: skip


def mutate(content: bytes, random: Random, edits: int | None = None) -> bytes:
    """Return bytes after some edits.

    Args:
        content: The bytes.
        random: Source of the choices.
        edits: Number of edits; one to four by default.
    """
    data = bytearray(content)
    for _ in range(edits or random.choice((1, 1, 1, 2, 2, 3, 4))):
        random.choice(_EDITS)(data, random)
    return bytes(data)


def mutate_text(content: bytes, random: Random) -> bytes:
    """Return a text after some edits of its lines and words, or of its bytes."""
    if random.random() < 0.3:
        return mutate(content, random)
    lines = content.split(b"\n")
    for _ in range(random.choice((1, 1, 1, 2, 3))):
        random.choice(_LINE_EDITS)(lines, random)
    return b"\n".join(lines)


def mutate_archive(content: bytes, random: Random) -> bytes:
    """Return a ZIP archive with a mutated part, or without one."""
    if random.random() < 0.2:
        return mutate(content, random)
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        parts = {name: archive.read(name) for name in archive.namelist()}
    name = random.choice(sorted(parts))
    choice = random.random()
    if choice < 0.05:
        del parts[name]
    elif choice < 0.1:
        parts[random.choice(sorted(parts))] = parts[name]
    else:
        parts[name] = random.choice((mutate, mutate_markup))(parts[name], random)
    stream = io.BytesIO()
    with warnings.catch_warnings(action="ignore"), zipfile.ZipFile(stream, "w") as archive:
        for name, part in parts.items():
            archive.writestr(name, part)
    return stream.getvalue()


def mutate_markup(content: bytes, random: Random) -> bytes:
    """Return XML with a mutated tag, attribute or text."""
    pieces = content.replace(b">", b">\n").replace(b"<", b"\n<").split(b"\n")
    for _ in range(random.choice((1, 1, 2))):
        random.choice(_LINE_EDITS)(pieces, random)
    return b"".join(pieces)


def mutate_mat5(content: bytes, random: Random) -> bytes:
    """Return a MATLAB file of version 5 with a mutated element, whose bytes are compressed again if they were."""
    (kind, length) = struct.unpack_from("<II", content, 128)
    if kind != 15 or random.random() < 0.3:
        return mutate(content, random)
    head, places, at = content[:128], [], 128
    while at < len(content):
        kind, length = struct.unpack_from("<II", content, at)
        places.append((at + 8, at + 8 + length))
        at += 8 + length
    chosen = random.randrange(len(places))
    parts = []
    for number, (begin, end) in enumerate(places):
        part = zlib.decompress(content[begin:end])
        packed = zlib.compress(mutate(part, random) if number == chosen else part)
        parts.append(struct.pack("<II", 15, len(packed)) + packed)
    return head + b"".join(parts)


def _flip(data: bytearray, random: Random) -> None:
    if data:
        data[random.randrange(len(data))] ^= 1 << random.randrange(8)


def _byte(data: bytearray, random: Random) -> None:
    if data:
        data[random.randrange(len(data))] = random.choice((0, 1, 0x7F, 0x80, 0xFF, random.randrange(256)))


def _number(data: bytearray, random: Random) -> None:
    width = random.choice((1, 2, 4, 4, 8))
    if len(data) >= width:
        at = random.randrange(len(data) - width + 1)
        value = random.choice(_NUMBERS) & (2 ** (8 * width) - 1)
        data[at : at + width] = value.to_bytes(width, random.choice(("little", "big")))


def _span(data: bytearray, random: Random) -> tuple[int, int]:
    begin = random.randrange(len(data) + 1)
    return begin, min(len(data), begin + random.choice((1, 2, 4, 8, 16, 64, 256, len(data))))


def _delete(data: bytearray, random: Random) -> None:
    begin, end = _span(data, random)
    del data[begin:end]


def _repeat(data: bytearray, random: Random) -> None:
    begin, end = _span(data, random)
    data[begin:begin] = data[begin:end] * random.choice((1, 1, 2, 50))


def _move(data: bytearray, random: Random) -> None:
    begin, end = _span(data, random)
    at = random.randrange(len(data) + 1)
    data[at : at + end - begin] = data[begin:end]


def _zero(data: bytearray, random: Random) -> None:
    begin, end = _span(data, random)
    data[begin:end] = bytes(end - begin)


def _insert(data: bytearray, random: Random) -> None:
    at = random.randrange(len(data) + 1)
    data[at:at] = random.choice((random.randbytes(random.randrange(1, 9)), random.choice(_WORDS)))


def _cut(data: bytearray, random: Random) -> None:
    del data[random.randrange(len(data) + 1) :]


_EDITS = (_flip, _flip, _flip, _byte, _byte, _number, _number, _number, _delete, _repeat, _move, _zero, _insert, _cut)


def _line(lines: list[bytes], random: Random) -> int:
    if not lines:
        lines.append(b"")
    return random.randrange(len(lines))


def _delete_line(lines: list[bytes], random: Random) -> None:
    del lines[_line(lines, random)]


def _repeat_line(lines: list[bytes], random: Random) -> None:
    at = _line(lines, random)
    lines[at:at] = [lines[at]] * random.choice((1, 1, 2, 40))


def _swap_lines(lines: list[bytes], random: Random) -> None:
    a, b = _line(lines, random), _line(lines, random)
    lines[a], lines[b] = lines[b], lines[a]


def _replace_line(lines: list[bytes], random: Random) -> None:
    lines[_line(lines, random)] = random.choice(_WORDS)


def _insert_line(lines: list[bytes], random: Random) -> None:
    lines.insert(_line(lines, random), random.choice(_WORDS))


def _replace_value(lines: list[bytes], random: Random) -> None:
    """Replace what follows a sign such as = or a comma in a line."""
    at = _line(lines, random)
    words = lines[at]
    places = [k for k, byte in enumerate(words) if byte in b'=,:;[]"(<> ']
    if places:
        begin = random.choice(places) + 1
        end = random.choice([k for k in (*places, len(words)) if k >= begin] or [len(words)])
        lines[at] = words[:begin] + random.choice((b"", b" ", b'"')) + random.choice(_WORDS) + words[end:]


def _mutate_line(lines: list[bytes], random: Random) -> None:
    at = _line(lines, random)
    lines[at] = mutate(lines[at], random, 1)


_LINE_EDITS = (
    _delete_line, _repeat_line, _swap_lines, _replace_line, _insert_line, _replace_value, _replace_value, _replace_value,
    _replace_value, _mutate_line,
)  # fmt: skip
