"""Names of file types, by their first bytes."""

HEAD_BYTES = 512

_STARTS = {
    b"\x89PNG": "a PNG image",
    b"\xff\xd8\xff": "a JPEG image",
    b"BM": "a BMP image",
    b"II*\0": "a TIFF image",
    b"MM\0*": "a TIFF image",
    b"GIF8": "a GIF image",
    b"8BPS": "PSD",
    b"\xff\x0a": "JPEG XL",
    b"\0\0\0\x0cJXL ": "JPEG XL",
    b"\0\0\0\x0cjP  ": "JPEG 2000",
    b"%PDF": "PDF",
    b"PK\x03\x04": "a ZIP archive",
    b"7z\xbc\xaf\x27\x1c": "a 7z archive",
    b"Rar!": "a RAR archive",
    b"\x1f\x8b": "a gzip archive",
    b"BZh": "a bzip2 archive",
    b"\xfd7zXZ": "an xz archive",
    b"\x28\xb5\x2f\xfd": "a Zstandard archive",
    b"#EXTM3U": "a playlist (M3U)",
    b"ffconcat": "a playlist (ffconcat)",
    b"[playlist]": "a playlist (PLS)",
    b"ID3": "sound (MP3)",
    b"fLaC": "sound (FLAC)",
    b".RMF": "RealMedia",
    b"YUV4MPEG2": "YUV4MPEG",
    b"\x06\x0e\x2b\x34": "MXF",
    b"<": "a page or XML",
    b"{": "JSON",
}
_BRANDS = {
    **dict.fromkeys((b"avif", b"avis"), "AVIF"),
    **dict.fromkeys((b"heic", b"heix", b"heim", b"heis", b"hevc", b"mif1", b"msf1"), "HEIC"),
}
_RIFF = {b"WEBP": "a WebP image", b"WAVE": "sound (WAV)"}
_DASH, _ANIMATION, _TAR = b"<MPD", b"ANIM", b"ustar"


def kind_of(data: bytes) -> str:
    r"""Name the kind of a file, given at least its first :data:`HEAD_BYTES`.

    Examples
    --------
    >>> kind_of(b"#EXTM3U\n#EXTINF:2,\none.ts")
    'a playlist (M3U)'
    """
    head = data[:HEAD_BYTES].removeprefix(b"\xef\xbb\xbf").lstrip(b"\r\n\t ")
    if head[4:8] == b"ftyp":
        return _BRANDS.get(head[8:12], "a video")
    if head.startswith(b"RIFF") and head[8:12] in _RIFF:
        animated = head[8:12] == b"WEBP" and _ANIMATION in head
        return "an animated WebP image" if animated else _RIFF[head[8:12]]
    if _DASH in head:
        return "a playlist (DASH)"
    if head[257:262] == _TAR:
        return "a tar archive"
    named = (name for start, name in _STARTS.items() if head.startswith(start))
    return next(named, "something else or a broken one")
