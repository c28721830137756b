"""Files as a laboratory has them: a camera's events in four formats, a photodiode's trace as CSV.  Shares no code."""

from __future__ import annotations

from pathlib import Path

import numpy as np

SUFFIX = {"csv": ".csv", "raw": ".raw", "npz": ".npz", "txt": ".txt"}
EPOCH_US = 1_700_000_000_000_000  # what cameras with a host's clock show
TIME_HIGH, EXTERNAL_TRIGGER = 0x8, 0xA  # types of EVT 2.0 words; 0 and 1 are OFF and ON events
PULSE_US = 10_000  # how long the trigger stays high


def write_events(
    path: Path, form: str, t_us: np.ndarray, x: np.ndarray, y: np.ndarray, p: np.ndarray, edges_us: np.ndarray
) -> None:
    """Events (n,) in order of time, polarity 1 ON and 0 OFF; trigger edges (m,) go into raw files alone."""
    if form == "csv":
        np.savetxt(path, np.column_stack([t_us, x, y, p]), fmt="%d", delimiter=",", header="t,x,y,p", comments="")
    elif form == "txt":
        lines = [f"{t // 10**6}.{t % 10**6:06d} {a} {b} {c}\n" for t, a, b, c in zip(t_us, x, y, p, strict=True)]
        path.write_text("".join(lines))
    elif form == "npz":
        columns = {"t": t_us.astype(np.int64), "x": x.astype(np.uint16), "y": y.astype(np.uint16)}
        np.savez_compressed(path, **columns, p=p.astype(np.uint8))
    elif form == "raw":
        path.write_bytes(evt2(t_us, x, y, p, edges_us))
    else:
        raise ValueError(f"no format {form!r}")


def evt2(t_us: np.ndarray, x: np.ndarray, y: np.ndarray, p: np.ndarray, edges_us: np.ndarray) -> bytes:
    """Prophesee's EVT 2.0 with rising edges at `edges_us`, each followed by a falling one."""
    falls = np.asarray(edges_us) + PULSE_US
    times = np.concatenate([t_us, edges_us, falls]).astype(np.int64)
    low = (times & 63) << 22
    kinds = [
        (p.astype(np.int64) << 28) | (x.astype(np.int64) << 11) | y.astype(np.int64),
        np.full(len(falls), (EXTERNAL_TRIGGER << 28) | 1),
        np.full(len(falls), EXTERNAL_TRIGGER << 28),
    ]
    words = np.concatenate(kinds) | low
    order = np.argsort(times, kind="stable")
    if len(edges_us):  # the recording ends with the last rising edge
        order = order[times[order] <= max(np.max(edges_us), t_us[-1] if len(t_us) else 0)]
    times, words = times[order], words[order]
    high = times >> 6
    new = np.flatnonzero(np.diff(high, prepend=-1))
    stream = np.insert(words, new, (TIME_HIGH << 28) | high[new])
    return b"% evt 2.0\n% geometry 640x480\n% end\n" + stream.astype("<u4").tobytes()


def write_light(path: Path, form: str, t_s: np.ndarray, light: np.ndarray, unit: str) -> None:
    """A trace (n,) in csv or npz, whose column's header or `unit` states the unit."""
    if form == "npz":
        stated = unit.split("_")[1]
        np.savez_compressed(path, t=t_s, radiance=light.astype(np.float32), unit=stated)
        return
    np.savetxt(path, np.column_stack([t_s, light]), fmt=["%.7f", "%.7g"], delimiter=",",
               header=f"t_s,{unit}", comments="")  # fmt: skip
