"""A reconstructed scene to fly through: one page with its splats and a renderer for CPUs, without a server.

`templates/scene.js` blends and counts events, which tests compare with the renderer; `templates/fly.js` moves.
"""

from __future__ import annotations

import base64
import json
from pathlib import Path
from typing import Any

import numpy as np

from pixelid.outputs import whole_file
from pixelid.report.html import TEMPLATES
from pixelid.report.scripts import script
from pixelid.results import number

MOST_SPLATS = 60_000  # 1.1 MB of a page; a picture then takes some 50 ms on one core
# times the deviation h / √2π of `splats`: between four of them (1 − exp(−(h/√2)² / 2σ²))⁴ shines through, 38 % at their
# own width and 6 % at this one; the surface is closed
WIDER = 1.5
FIELD_OF_VIEW = 0.9  # rad
USUAL_THRESHOLD = 0.25  # ln units, where the scene was trained without a pixel


def scene_page(folder: Path) -> str:
    """The page of a reconstruction's folder as text.

    Raises:
        InputError: no scene there, a damaged one, or one in which everything is clear.
    """
    import jinja2

    from pixelid.nerf.shown.frames import eight_bits
    from pixelid.nerf.shown.render import tone_of
    from pixelid.nerf.shown.saved import SavedReconstruction
    from pixelid.nerf.shown.splats import splats_of
    from pixelid.nerf.shown.ways import around

    saved = SavedReconstruction.load(folder)
    splats = splats_of(saved.field)
    way = around(saved.field.low, saved.field.high, "orbit", 1, (240, 180), fov=FIELD_OF_VIEW)
    dark = saved.dark
    tone, notes = tone_of(saved, way, dark)

    def colours(radiance: np.ndarray) -> np.ndarray:
        """(n, C) → (n, 3) in 256 levels."""
        return np.broadcast_to(eight_bits(tone(radiance[None] + dark))[0], (len(radiance), 3))

    kept, grown = _kept(splats.opacity)
    radiance = np.exp(splats.log_radiance[kept])
    size = np.cbrt(splats.deviation[kept].prod(axis=1)) * WIDER * grown
    fine = np.column_stack([splats.centre[kept], np.log(radiance.mean(axis=1)), np.log(size)])
    ranges = np.column_stack([fine.min(axis=0), fine.max(axis=0)])
    width = np.maximum(ranges[:, 1] - ranges[:, 0], 1e-12)
    packed = np.round(65535 * (fine - ranges[:, 0]) / width).astype("<u2").tobytes()
    paint = np.column_stack([colours(radiance), np.round(255 * splats.opacity[kept])]).astype(np.uint8)
    behind = np.exp(saved.field.log_background.detach().cpu().numpy())[None]
    middle, position = 0.5 * (saved.field.low + saved.field.high), way.position[0]
    ahead = (middle - position) / np.linalg.norm(middle - position)
    pixel = saved.content["pixel"]
    head: dict[str, Any] = {
        "count": len(kept), "ranges": ranges.tolist(), "fov": FIELD_OF_VIEW,
        "background": {"radiance": float(behind.mean()), "colour": colours(behind)[0].tolist()},
        "start": {"position": position.tolist(), "yaw": float(np.arctan2(ahead[1], ahead[0])),
                  "pitch": float(np.arcsin(ahead[2]))},
        "middle": middle.tolist(), "distance": float(np.linalg.norm(middle - position)),
        "on": _threshold(pixel, "on_threshold"), "off": _threshold(pixel, "off_threshold"), "dark": float(dark.mean()),
    }  # fmt: skip
    if len(kept) < len(splats.opacity):
        notes.append(f"{len(kept)} of {len(splats.opacity)} splats are shown, each {number(grown)} times as wide")
    if splats.coefficients.shape[2]:
        notes.append("colours do not change with the direction, as those of the reconstruction do")
    notes.append(
        f"events are those of the changing pictures at the pixel's thresholds, ON {number(head['on'])} and OFF "
        f"{number(head['off'])}, without its bandwidth and noise"
    )
    template = (TEMPLATES / "scene.html").read_text(encoding="utf-8")
    return jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined).from_string(template).render(
        title=f"Fly through {folder.resolve().name}",
        style=(TEMPLATES / "style.css").read_text(encoding="utf-8"),
        head=json.dumps(head).replace("<", "\\u003c"),
        splats=base64.b64encode(packed + paint.tobytes()).decode(),
        notes=" ".join(f"{note[:1].upper()}{note[1:]}." for note in notes),
        scripts=[script("scene"), script("fly")],
    )  # fmt: skip


def write_scene(folder: Path, path: Path, *, overwrite: bool = False) -> None:
    """Write the page of a reconstruction's folder.  Raises InputError as `scene_page`, and where `path` is there."""
    text = scene_page(folder)
    with whole_file(path, overwrite) as temporary:
        temporary.write_text(text, encoding="utf-8")


def _kept(opacity: np.ndarray) -> tuple[np.ndarray, float]:
    """(indices of the splats shown, factor on their width): faint ones go first, then a random share."""
    if len(opacity) <= MOST_SPLATS:
        return np.arange(len(opacity)), 1.0
    order = np.argsort(-opacity, kind="stable")
    faint = 0.1  # opacity below which splats are the first to go
    seen = max(int((opacity >= faint).sum()), MOST_SPLATS)
    if seen == MOST_SPLATS:
        return np.sort(order[:MOST_SPLATS]), 1.0
    chosen = np.random.default_rng(0).choice(order[:seen], MOST_SPLATS, replace=False)
    return np.sort(chosen), float(np.sqrt(seen / MOST_SPLATS))  # of a surface: as much of it is covered


def _threshold(pixel: dict[str, Any], name: str) -> float:
    value = pixel.get(name)
    value = float(np.mean(value)) if isinstance(value, int | float | list) else USUAL_THRESHOLD
    return value if np.isfinite(value) and value > 0 else USUAL_THRESHOLD
