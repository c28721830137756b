"""Events in the order the likelihood reads them: each with its pixel's previous event, in order of time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pixelid.recordings.recording import Recording


@dataclass(frozen=True)
class Sequences:
    """Intervals between consecutive events of each pixel, and each pixel's last, unfinished interval.

    previous_s, time_s: (n,) start (time of the previous event) and end of each interval, seconds
    sign: (n,) +1 ON, −1 OFF of the event that ends it;  previous_sign: of the event that began it
    pixel: (n,) flat pixel index
    event, previous_event: (n,) indices in the recording of the events that end and begin it
    last_s, last_pixel, last_sign: (m,) per pixel with events, where its censored interval begins
    end_s: when the recording ends;  tick_s: width of a timestamp
    """

    previous_s: np.ndarray
    time_s: np.ndarray
    sign: np.ndarray
    previous_sign: np.ndarray
    pixel: np.ndarray
    event: np.ndarray
    previous_event: np.ndarray
    last_s: np.ndarray
    last_pixel: np.ndarray
    last_sign: np.ndarray
    end_s: float
    tick_s: float

    def __len__(self) -> int:
        return len(self.time_s)


def sequences(recording: Recording) -> Sequences:
    """The intervals of a recording.  The first event of a pixel only serves as a reference."""
    events = recording.events
    order = np.lexsort((events.t, events.pixel))
    pixel = events.pixel[order]
    time = events.t[order] * 1e-9
    sign = np.where(events.p[order] == 1, 1.0, -1.0)
    same = pixel[1:] == pixel[:-1]
    last = np.flatnonzero(np.append(~same, True)) if len(pixel) else np.empty(0, np.int64)
    follows = np.flatnonzero(same) + 1
    follows = follows[np.argsort(time[follows], kind="stable")]  # in order of time: neighbours share stimulus samples
    end = recording.stimulus.end_s if recording.stimulus is not None else 0.0
    if len(time):
        end = max(end, float(events.t[-1]) * 1e-9)
    return Sequences(
        previous_s=time[follows - 1],
        time_s=time[follows],
        sign=sign[follows],
        previous_sign=sign[follows - 1],
        pixel=pixel[follows],
        event=order[follows],
        previous_event=order[follows - 1],
        last_s=time[last],
        last_pixel=pixel[last],
        last_sign=sign[last],
        end_s=end,
        tick_s=events.tick_ns * 1e-9,
    )
