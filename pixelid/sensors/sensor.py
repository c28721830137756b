"""Fit every pixel of a sensor: estimates tile by tile, then the population, then each pixel shrunk towards it."""

from __future__ import annotations

import hashlib
import json
import os
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

from pixelid import __version__
from pixelid.cluster import Where, connected, run_tasks
from pixelid.documents import interpreting, read_json
from pixelid.errors import InputError, shown
from pixelid.model.files import load_model, save_model
from pixelid.model.model import Model
from pixelid.outputs import plain, set_aside, whole_file, write_json
from pixelid.provenance import input_hashes, versions
from pixelid.recordings.events import MOST_SIDE
from pixelid.recordings.recording import Recording
from pixelid.recordings.selection import unit_of_light
from pixelid.results import Result, Table, check_kinds, read_result, required
from pixelid.sensors.map import Map
from pixelid.sensors.profile import REACH, Plan, estimate_tile
from pixelid.sensors.shrinkage import bootstrap, population, shrink
from pixelid.sensors.tiles import common_size, tiles_of
from pixelid.status import Status

CHUNK = 20  # bootstrap replicates per task
MOST_UNEXPLAINED = 0.01  # of the events: ten times what makes a fit a misfit, since single pixels depart from its model
NOTE = "problem.json"  # in the folder of finished tiles: what they belong to


@dataclass(frozen=True, repr=False)
class SensorFit(Result):
    """Maps of a sensor.

    Attributes:
        maps: by the name of their parameter.
        events: (h, w) per pixel.
        tiles: how many units of work there were.
        block: side of the groups of pixels that share a bandwidth.
        model: the population's values before the fit.
        seconds: that it took.
        seed: of the bootstrap.
        inputs_sha256: hashes of the recordings by name.
        unexplained: share of the events that no circuit of the scan explains.

    Example:
        >>> from pixelid.sensors import SensorFit
        >>> SensorFit.load("maps").to_dataframe()  # doctest: +SKIP
    """

    FILE: ClassVar[str] = "sensor.json"

    maps: Mapping[str, Map]
    events: np.ndarray
    tiles: int
    block: int
    model: Model
    seconds: float
    seed: int
    inputs_sha256: Mapping[str, str]
    unexplained: float = 0.0

    @property
    def empty(self) -> list[str]:
        """Names of maps that the events of less than two pixels hold."""
        return [name for name, m in self.maps.items() if m.population.count < 2]

    @property
    def status(self) -> Status:
        """How it ended."""
        if self.unexplained > MOST_UNEXPLAINED:
            return Status.misfit
        return Status.not_identified if self.empty else Status.converged

    @property
    def advice(self) -> str:
        """What to do about events without a cause, and about empty maps."""
        if self.unexplained > MOST_UNEXPLAINED:
            share = f"{100 * self.unexplained:.2g} % of the events have no cause in {self.model.name}"
            return f"{share}: fit a model to these recordings first, or look for what it lacks with pixelid gap"
        if not self.empty:
            return ""
        return f"the events of fewer than two pixels hold {', '.join(self.empty)}: record more, or use larger --block"

    @property
    def headline(self) -> str:
        """Pixels, events, status."""
        seen = int((self.events > 0).sum())
        size = f"{seen} pixels, {self.events.sum()} events"
        return f"sensor of {self.model.name}: {self.status}; {size}, {self.seconds:.1f} s"

    def tables(self) -> list[Table]:
        """Mean, spread and errors of every map."""
        rows = []
        for name, entry in self.records_by_name().items():
            percent = [entry["relative_spread"], entry["typical_error_before"], entry["typical_error_after"]]
            cells = ["–" if v is None else f"{100 * v:.2g} %" for v in percent]
            rows.append((name, f"{entry['mean']:.4g} {entry['unit']}", *cells, str(entry["without_estimate"])))
        headings = ("parameter", "mean", "spread", "error alone", "error shrunk", "pixels without")
        return [Table("", headings, tuple(rows), frozenset({"parameter"}))]

    def records_by_name(self) -> dict[str, dict]:
        """Map → its entry in sensor.json."""
        return {name: m.as_dict() for name, m in self.maps.items()}

    def records(self) -> list[dict]:
        """One row per map."""
        return [{"parameter": name, **entry} for name, entry in self.records_by_name().items()]

    def sentences(self) -> list[str]:
        """Advice."""
        return [self.advice]

    def write_companions(self, folder: Path) -> None:
        """Write maps.npz, one picture per map, and model.toml, the population that the fit began with."""
        from pixelid.sensors.saving import write_maps

        write_maps(self.events, self.maps, folder)
        save_model(self.model, folder / "model.toml")

    @classmethod
    def load(cls, folder: str | Path) -> SensorFit:
        """The maps of a folder.

        Args:
            folder: that `save` or `pixelid sensor` wrote.

        Returns:
            The fit, as good as new.

        Raises:
            InputError: no maps there, or damaged ones.
        """
        from pixelid.sensors.saving import read_maps

        folder = Path(folder)
        content = read_result(folder, cls.FILE)
        check_kinds(
            content,
            folder / cls.FILE,
            a_table=("maps", "inputs_sha256"),
            a_number=("tiles", "block", "seconds", "seed"),
        )
        with interpreting(folder / cls.FILE, "maps of a sensor"):
            names = ("maps", "tiles", "block", "seconds", "seed", "inputs_sha256")
            entries, *plain_ones = required(content, folder, cls.FILE, *names)
            known = dict(zip(names[1:], plain_ones, strict=True))
            if not isinstance(known["block"], int) or not 1 <= known["block"] <= MOST_SIDE:
                raise ValueError(f"block: expected a positive integer, found {shown(known['block'])}")
            events, maps = read_maps(entries, folder, known["block"])
            unexplained = float(content.get("unexplained_fraction", 0.0))
            return cls(
                maps=maps, events=events, model=load_model(folder / "model.toml"), unexplained=unexplained, **known
            )

    def as_dict(self) -> dict:
        """The content of sensor.json."""
        height, width = self.events.shape
        return {
            "status": self.status,
            "advice": self.advice,
            "model": self.model.name,
            "width": width,
            "height": height,
            "block": self.block,
            "tiles": self.tiles,
            "events": int(self.events.sum()),
            "pixels_with_events": int((self.events > 0).sum()),
            "unexplained_fraction": self.unexplained,
            "maps": self.records_by_name(),
            "seconds": self.seconds,
            "seed": self.seed,
            "versions": versions(),
            "inputs_sha256": dict(self.inputs_sha256),
        }


def fit_sensor(
    recordings: list[Recording],
    model: Model,
    *,
    bandwidth: str = "sf_cutoff_hz",
    block: int = 1,
    tile: int = 32,
    replicates: int = 200,
    where: Where = Where(),
    keep: Path | None = None,
    seed: int = 0,
    progress: Callable[[str, float], None] | None = None,
) -> SensorFit:
    """Maps of both thresholds and of one bandwidth parameter over a sensor under full-field light.

    Args:
        recordings: of one sensor, with pixel addresses and stimuli.
        model: the population's values, as of a fit.
        bandwidth: the parameter mapped; "" for thresholds alone.
        block: side of the groups of pixels that share a bandwidth.
        tile: side of the units of work.
        replicates: of the bootstrap over pixels.
        where: the processes or cluster that work.
        keep: folder where finished tiles stay, so that an interrupted run goes on; it belongs to one set of inputs.
        seed: of the bootstrap.
        progress: called with what is done and the fraction.

    Returns:
        A map of each parameter, every pixel shrunk towards the population by what its own events say.

    Raises:
        InputError: recordings or options that do not fit together.
    """
    begun = time.perf_counter()
    report = progress or (lambda what, fraction: None)
    recordings, model = [r.within_stimulus() for r in recordings], model.with_radiance_in(unit_of_light(recordings))
    width, height = common_size(recordings)
    if block < 1 or tile < 1 or replicates < 0:
        raise InputError(f"expected block ≥ 1, tile ≥ 1, replicates ≥ 0, found {block}, {tile}, {replicates}")
    tile = -(-tile // block) * block
    plan = Plan(model, bandwidth, block, width)
    plan.check()
    tiles = tiles_of(width, height, tile)
    with connected(where) as client:
        identity = "" if keep is None else _claim(keep, recordings, plan, tile)
        parts = run_tasks(
            estimate_tile,
            len(tiles),
            lambda i: (plan, [tiles[i].cut(r) for r in recordings]),
            client=client,
            keep=keep,
            identity=identity,
            progress=lambda done: report("tiles", 0.9 * done),
        )
        events = np.zeros(height * width, np.int64)
        unexplained = sum(float(part["unexplained"].sum()) for part in parts)
        for part in parts:
            events[part["pixel"]] = part["events"]
        blocks = (-(-height // block), -(-width // block))
        shapes = {"on_threshold": ("on", (height, width)), "off_threshold": ("off", (height, width))}
        if bandwidth:
            shapes[bandwidth] = ("bandwidth", blocks)
        maps = {}
        for k, (name, (column, shape)) in enumerate(shapes.items()):
            index = "block" if column == "bandwidth" else "pixel"
            raw, sd = np.full(shape[0] * shape[1], np.nan), np.full(shape[0] * shape[1], np.inf)
            for part in parts:
                raw[part[index]], sd[part[index]] = part[column], part[f"{column}_sd"]
            maps[name] = _map(name, model.parameter(name).unit, raw, sd, shape, replicates, seed + k, client)
            report("population", 0.9 + 0.1 * (k + 1) / len(shapes))
    return SensorFit(
        maps,
        events.reshape(height, width),
        len(tiles),
        block,
        model,
        time.perf_counter() - begun,
        seed,
        input_hashes(r.source for r in recordings),
        unexplained / max(int(events.sum()), 1),
    )


def _map(name, unit, raw, sd, shape, replicates, seed, client) -> Map:
    spread_of_pixels = population(raw, sd)
    mean_interval = spread_interval = (np.nan, np.nan)
    if replicates and spread_of_pixels.count > 1:
        seeds = np.random.SeedSequence(seed).generate_state(replicates)
        chunks = [seeds[i : i + CHUNK] for i in range(0, replicates, CHUNK)]
        drawn = run_tasks(_replicates, len(chunks), lambda i: (raw, sd, chunks[i]), client=client)
        samples = np.concatenate([d["samples"] for d in drawn])
        low, high = np.percentile(samples, [2.5, 97.5], axis=0)
        mean_interval, spread_interval = (low[0], high[0]), (low[1], high[1])
    log, after = shrink(raw, sd, spread_of_pixels)
    return Map(
        name, unit, raw.reshape(shape), sd.reshape(shape), log.reshape(shape), after.reshape(shape), spread_of_pixels,
        mean_interval, spread_interval,
    )  # fmt: skip


def _replicates(raw: np.ndarray, sd: np.ndarray, seeds: np.ndarray) -> dict[str, np.ndarray]:
    return {"samples": bootstrap(raw, sd, seeds)}


def _claim(keep: Path, recordings: list[Recording], plan: Plan, tile: int) -> str:
    """Make the folder of finished tiles, setting one of another problem aside; the identity of this problem."""
    digest = hashlib.sha256()
    for r in recordings:
        assert r.stimulus is not None
        for column in (r.events.t, r.events.x, r.events.y, r.events.p, *r.stimulus.arrays.values()):
            digest.update(np.ascontiguousarray(column).tobytes())
    tiles = 2  # what a finished tile holds: raised when that changes
    problem = {
        "version": __version__,
        "data": digest.hexdigest(),
        "model": {**plan.model.values, "photoreceptor": plan.model.photoreceptor, "effects": plan.model.effects},
        "plan": [plan.bandwidth, plan.block, REACH, tile],
        "tiles": tiles,
    }
    identity = hashlib.sha256(json.dumps(plain(problem), sort_keys=True).encode()).hexdigest()
    note = keep / NOTE
    if os.path.lexists(keep) and _noted(note) != identity and any(keep.iterdir() if keep.is_dir() else [keep]):
        set_aside(keep, "holds tiles of another run", "other")
    keep.mkdir(exist_ok=True)
    with whole_file(note, overwrite=True) as path:
        write_json(path, {"identity": identity})
    return identity


def _noted(note: Path) -> object:
    """The identity that a folder of tiles was made for; None where none can be read."""
    try:
        return read_json(note).get("identity")
    except InputError:
        return None
