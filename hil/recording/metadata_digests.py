"""Digests of the metadata records of a recording: they show damage that no CRC covers.

Metadata records have no CRC of their own, and a file that was cut off has no CRC of its data. Therefore the
record ``digests`` precedes the metadata at the beginning of a file, and the record ``digests of the end``
those at its end. Each holds the SHA-256 of the records that follow it, by their names.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping

Metadata = Mapping[str, Mapping[str, str]]
"""Entries of metadata records, by the names of the records."""

DIGESTS, END_DIGESTS = "digests", "digests of the end"
"""Names of the records that hold the digests of the metadata before the first message, and after the last."""
DIGEST_KIND = "metadata digests"
"""Key, in metadata ``recording``, which says that every record has a digest. Its value is "sha256"."""


def with_digests(metadata: Metadata, name: str) -> dict[str, Mapping[str, str]]:
    """Return the records with the record ``name`` in front, which holds their digests."""
    return {name: {key: digest(key, entries) for key, entries in metadata.items()}, **metadata}


def damaged_metadata(metadata: Metadata) -> list[str]:
    """Return the names of records that differ from their digest, lack one, or are missing, in order.

    Records at the end of a file may be missing, since a file that was cut off has not all of them. Metadata
    without any digest, as pneumatic-hil 0.2 recorded them, are not damaged.
    """
    if DIGESTS not in metadata and DIGEST_KIND not in metadata.get("recording", {}):
        return []
    at_begin = metadata.get(DIGESTS, {})
    stated = {**at_begin, **metadata.get(END_DIGESTS, {})}
    found = [name for name in metadata if name not in (DIGESTS, END_DIGESTS)]
    changed = [name for name in found if stated.get(name) != digest(name, metadata[name])]
    return sorted({*changed, *(name for name in at_begin if name not in metadata)})


def digest(name: str, entries: Mapping[str, str]) -> str:
    """Return the SHA-256 of name, keys and values of a metadata record, in hexadecimal."""
    found = hashlib.sha256()
    for text in (name, *(text for entry in sorted(entries.items()) for text in entry)):
        encoded = text.encode("utf-8", "replace")
        found.update(len(encoded).to_bytes(4, "little") + encoded)
    return found.hexdigest()
