"""Text files as lines: which bytes are which letters, and what is no text at all."""

from os import PathLike
from pathlib import Path

from calibration.data.recording import RecordingError

# Reading takes about six times the size of the file in memory.
_LARGEST = 1 << 30
# How files begin that are no text, and what to do with them.
_MAGIC = {
    b"PK\x03\x04": "an Excel workbook or another archive: export the sheet as CSV",
    b"\xd0\xcf\x11\xe0": "an old Excel workbook: export the sheet as CSV",
    b"%PDF": "a PDF: export the numbers as CSV",
    b"\x89HDF": "an HDF5 file: rename it to .h5",
    b"MATLAB 5.0": "a MAT file: rename it to .mat",
    b"MATLAB 7.3": "a MAT file: rename it to .mat",
    b"PAR1": "a Parquet file: rename it to .parquet",
    b"TDSm": "a TDMS file: export it as CSV",
    b"\x1f\x8b": "compressed: unpack it first",
}
_MARKS = (
    (b"\xef\xbb\xbf", "utf-8-sig"),
    (b"\xff\xfe\x00\x00", "utf-32"),
    (b"\x00\x00\xfe\xff", "utf-32"),
    (b"\xff\xfe", "utf-16"),
    (b"\xfe\xff", "utf-16"),
)


def read_lines(path: str | PathLike, encoding: str | None = None) -> tuple[list[str], str]:
    """The lines of a text file, and the encoding that was found: UTF-8 or UTF-16 or, if it is
    neither, that of Windows in Western Europe (Latin-1 with more signs).

    Raises `RecordingError` if it cannot be read, is too large, or is no text.
    """
    try:
        size = Path(path).stat().st_size
        if size > _LARGEST:
            raise RecordingError(
                f"{path}: {size / 1e9:.2g} GB of text, of which at most {_LARGEST / 1e9:.2g} are "
                "read into memory: cut it, or keep every tenth row"
            )
        content = Path(path).read_bytes()
    except (OSError, ValueError) as e:
        if isinstance(e, RecordingError):
            raise
        reason = getattr(e, "strerror", None) or e
        raise RecordingError(f"{path}: cannot read the recording: {reason}") from None
    for magic, what in _MAGIC.items():
        if content.startswith(magic):
            raise RecordingError(f"{path}: is {what}")
    encoding = encoding or _encoding(content)
    try:
        text = content.decode(encoding)
    except (ValueError, LookupError) as e:
        raise RecordingError(
            f"{path}: cannot be read as {encoding}: {e}; set [csv] encoding in the mapping"
        ) from None
    if "\0" in text:
        raise RecordingError(f"{path}: holds bytes that are no text: is it a CSV?")
    return text.replace("\r\n", "\n").replace("\r", "\n").split("\n"), encoding


def _encoding(content: bytes) -> str:
    for mark, name in _MARKS:
        if content.startswith(mark):
            return name
    # Numbers in UTF-16 without a mark: every other byte is zero.
    head = content[:400]
    if len(head) > 3 and head[1::2].count(0) > 0.4 * len(head) and head[::2].count(0) == 0:
        return "utf-16-le"
    if len(head) > 3 and head[::2].count(0) > 0.4 * len(head) and head[1::2].count(0) == 0:
        return "utf-16-be"
    try:
        content.decode("utf-8")
    except UnicodeDecodeError:
        # The five bytes that Windows leaves open are letters in Latin-1.
        try:
            content.decode("cp1252")
        except UnicodeDecodeError:
            return "latin-1"
        return "cp1252"
    return "utf-8"
