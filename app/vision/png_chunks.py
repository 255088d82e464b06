"""A guard before OpenCV's PNG reader, which believes what a chunk says of its length.

A kilobyte that announces a chunk of two gigabytes makes it set aside and clear two
gigabytes, for many seconds, before it notices that they are not there.
"""

from __future__ import annotations

from app.vision.image_header import ImageError

_SIGNATURE = b"\x89PNG\r\n\x1a\n"


def check_png_chunks(data: bytes) -> None:
    """Raise :class:`ImageError` for a PNG with a chunk that does not end within the file.

    Other formats pass. So does what follows the chunk ``IEND``: nobody reads it.
    """
    if not data.startswith(_SIGNATURE):
        return
    position = len(_SIGNATURE)
    while position + 12 <= len(data):
        kind = data[position + 4 : position + 8]
        position += 12 + int.from_bytes(data[position : position + 4], "big")
        if kind == b"IEND" and position <= len(data):
            return
    raise ImageError("the PNG image is broken: a chunk does not end within the file")
