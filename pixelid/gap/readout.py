"""Temporary names for `inspection.timestamps`, until the gap calls it by its own."""

from __future__ import annotations

from pixelid.inspection.timestamps import TimestampSignature as Fingerprint
from pixelid.inspection.timestamps import find_grid as grid
from pixelid.inspection.timestamps import find_service_time as service
from pixelid.inspection.timestamps import find_timestamp_signatures as fingerprints

__all__ = ["Fingerprint", "fingerprints", "grid", "service"]
