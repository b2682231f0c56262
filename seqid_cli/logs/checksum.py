"""CRC-32 of zlib, as MCAP uses it; of isal where that is installed, which is ten times faster."""

from __future__ import annotations

try:
    from isal.isal_zlib import crc32
except ImportError:
    from zlib import crc32

__all__ = ["crc32"]
