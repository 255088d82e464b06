"""The chunks of a PNG, and a guard before OpenCV's reader, which believes what a chunk announces.

A kilobyte that announces a chunk of two gigabytes makes it set aside and clear two
gigabytes, for many seconds, before it notices that they are not there.
"""

from __future__ import annotations

from collections.abc import Iterator

from app.vision.decoding.image_header import ImageError

_SIGNATURE = b"\x89PNG\r\n\x1a\n"


def png_chunks(data: bytes) -> Iterator[memoryview]:
    """Yield the chunks of a PNG, length and checksum included, to ``IEND``.

    It ends before a chunk that does not end within the file.
    """
    whole = memoryview(data)
    position = len(_SIGNATURE)
    while position + 12 <= len(data):
        end = position + 12 + int.from_bytes(whole[position : position + 4], "big")
        if end > len(data):
            return
        yield whole[position:end]
        if data[position + 4 : position + 8] == b"IEND":
            return
        position = end


def check_png_chunks(data: bytes) -> None:
    """Raise :class:`ImageError` for a PNG with a chunk that does not end within the file.

    Other formats pass. So does what follows the chunk ``IEND``: nobody reads it.
    """
    if not data.startswith(_SIGNATURE):
        return
    if not any(bytes(chunk[4:8]) == b"IEND" for chunk in png_chunks(data)):
        raise ImageError("the PNG image is broken: a chunk does not end within the file")
