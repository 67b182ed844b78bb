"""Joins PNG files of one size and kind into one animated PNG: animate.py OUT.png FRAMES_A_SECOND FRAME.png …"""

import struct
import sys
import zlib
from pathlib import Path


def chunks(path):
    """The chunks of a PNG file as (type, bytes)."""
    text, at = Path(path).read_bytes(), 8
    while at < len(text):
        (length,) = struct.unpack(">I", text[at : at + 4])
        yield text[at + 4 : at + 8], text[at + 8 : at + 8 + length]
        at += length + 12


def chunk(kind, body):
    return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))


def main(out, rate, *frames):
    text, sequence = b"\x89PNG\r\n\x1a\n", 0
    for number, frame in enumerate(frames):
        parts = list(chunks(frame))
        header = dict(parts)[b"IHDR"]
        pixels = zlib.decompress(b"".join(body for kind, body in parts if kind == b"IDAT"))
        if number == 0:
            text += chunk(b"IHDR", header) + chunk(b"acTL", struct.pack(">II", len(frames), 0))
        width, height = struct.unpack(">II", header[:8])
        text += chunk(b"fcTL", struct.pack(">IIIIIHHBB", sequence, width, height, 0, 0, 1, int(rate), 0, 0))
        sequence += 1
        packed = zlib.compress(pixels, 9)
        if number == 0:
            text += chunk(b"IDAT", packed)
        else:
            text += chunk(b"fdAT", struct.pack(">I", sequence) + packed)
            sequence += 1
    Path(out).write_bytes(text + chunk(b"IEND", b""))


if __name__ == "__main__":
    main(*sys.argv[1:])
