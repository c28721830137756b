"""Datasets of procedural scenes: events by the simulator, written in the published layout.

The simulated pixel is fuller than the one reconstructions assume: thresholds differ from pixel to pixel and from event
to event, pixels integrate light over their area, and the light is sampled much more finely than training samples it.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from pixelid.model.model import Model
from pixelid.model.shipped import find_model
from pixelid.nerf.data import calibration as layout
from pixelid.nerf.data.camera import Camera, pinhole
from pixelid.nerf.data.dataset import EVENTS, write_poses
from pixelid.nerf.data.scenes import FIELD_OF_VIEW, procedural, random_views, spiral
from pixelid.nerf.data.trajectory import Trajectory
from pixelid.nerf.data.views import FOLDER, OPENGL, RENDERER
from pixelid.outputs import whole_folder
from pixelid.parameters.invariants import Physical
from pixelid.simulate import simulate_stream
from pixelid.stages.photoreceptor import NOMINAL

SPLITS = (("train", 8, 1), ("val", 8, 2), ("test", 8, 3))


class Renders(Protocol):
    """Anything that can be filmed: images (n, height, width) of cameras at position (n, 3), rotation (n, 3, 3)."""

    def render(self, camera: Camera, position, rotation, supersample: int) -> np.ndarray: ...


@dataclass(frozen=True)
class Setting:
    """How fast and how dark: revolutions per second, and the photocurrent of white and of darkness [fA]."""

    revolutions_per_s: float
    white_fa: float
    dark_fa: float = 4.0


SETTINGS = {
    "easy": Setting(0.25, 200_000.0),
    "medium": Setting(2.0, 2_000.0),
    "medium8": Setting(8.0, 2_000.0),
    "hard": Setting(4.0, 20.0),
    "hard8": Setting(8.0, 20.0),
}


def camera_model(setting: Setting) -> Model:
    """The simulated camera: DVS128 values, thresholds 0.25, 2 % mismatch and noise, dead time, dark current."""
    model = find_model("dvs128").with_effect("dark_current", {"radiance": setting.dark_fa})
    return model.set({"threshold_sigma": 0.02, "threshold_mismatch.sigma": 0.02, "refractory_s": 1e-4})


def make_dataset(
    out: Path,
    setting: Setting | str = "hard",
    *,
    seed: int = 0,
    scene: Renders | None = None,
    side: int = 64,
    revolutions: float = 4.0,
    trajectory: Trajectory | None = None,
    model: Model | None = None,
    nominal: Physical = NOMINAL,
    frames_per_turn: int = 1200,
    supersample: int = 2,
    overwrite: bool = False,
    progress: Callable[[str, float], None] = lambda what, share: None,
) -> Path:
    """Write a dataset folder of a procedural scene.

    scene: what is filmed (default `scenes.procedural(seed)`);  trajectory: of the camera, from time zero (default
    `scenes.spiral` of so many revolutions);  model: the camera that makes the events, radiance in fA
    (default `camera_model`);  nominal: the circuit values that the calibration file quotes, which need not be the
    camera's;  frames_per_turn: of the rendered light, log radiance linear in between;  supersample: rays per pixel and
    side.
    """
    setting = SETTINGS[setting] if isinstance(setting, str) else setting
    scene, camera = procedural(seed) if scene is None else scene, pinhole(side, side, FIELD_OF_VIEW)
    model = camera_model(setting) if model is None else model
    if trajectory is None:
        trajectory = spiral(revolutions / setting.revolutions_per_s, revolutions)
    frames = round(revolutions * frames_per_turn) + 1
    video = _video(scene, camera, trajectory, frames, supersample, setting.white_fa, progress)
    chunks = list(simulate_stream(model, video, seed=seed + 1000))
    t, x, y, p = (np.concatenate([getattr(chunk, name) for chunk in chunks]) for name in "txyp")
    last = int(trajectory.t[-1] * 1e9)
    kept = t <= last
    with whole_folder(Path(out), overwrite, markers=(EVENTS,)) as folder:
        np.savez(
            folder / EVENTS, position=np.column_stack([x, y])[kept], timestamp=t[kept], polarity=p[kept].astype(bool)
        )
        write_poses(folder, trajectory)
        _write_calibration(folder, camera, model, setting, nominal)
        np.savez(folder / RENDERER, interm_color_space="linear", log_eps=0.0)
        write_views(folder, scene, camera, seed)
    return Path(out)


def _video(scene, camera, trajectory, frames, supersample, white, progress) -> Iterator[tuple[float, np.ndarray]]:
    """(t, radiance (height, width) in fA without dark current) of every frame."""
    times = np.linspace(0.0, trajectory.t[-1], frames)
    for begin in range(0, frames, 256):
        some = times[begin : begin + 256]
        images = scene.render(camera, *trajectory.at(some), supersample)
        progress("rendering light", begin / frames)
        yield from ((float(t), white * image) for t, image in zip(some, images, strict=True))


def _write_calibration(folder: Path, camera: Camera, model: Model, setting: Setting, nominal: Physical) -> None:
    values = model.values
    np.savez(
        folder / layout.FILE,
        intrinsics=camera.intrinsics, distortion_params=np.zeros(0), distortion_model="plumb_bob",
        img_height=camera.height, img_width=camera.width, bayer_pattern="",
        pos_contrast_threshold=values["on_threshold"], neg_contrast_threshold=values["off_threshold"],
        refractory_period=round(values.get("refractory_s", 0.0) * 1e9),
        input_time_const_eff_it_prod=nominal.q_in / setting.white_fa,
        miller_time_const_eff_it_prod=nominal.q_mil / setting.white_fa,
        black_level=np.array([setting.dark_fa / setting.white_fa]),
        amplifier_gain=nominal.A_amp, closed_loop_gain=nominal.A_amp / nominal.A_loop,
        output_time_const=nominal.tau_out, lower_cutoff_freq=0.0,
        sf_cutoff_freq=3122.0, diff_amp_cutoff_freq=16000.0,
    )  # fmt: skip


def write_views(folder: Path, scene: Renders, camera: Camera, seed: int) -> None:
    """Write `views/` of a scene: train, val and test, each from its own random places, 32-bit linear TIFF."""
    from skimage.io import imsave

    (folder / FOLDER).mkdir()
    view_rays = 4  # per pixel and side
    for stage, number, offset in SPLITS:
        position, rotation = random_views(number, 7919 * seed + offset)
        images = scene.render(camera, position, rotation, view_rays).astype(np.float32)
        (folder / FOLDER / stage).mkdir()
        frames = []
        for k, image in enumerate(images):
            pose = np.eye(4)
            pose[:3, :3], pose[:3, 3] = rotation[k] @ OPENGL, position[k]
            imsave(folder / FOLDER / stage / f"r_{k}.tiff", image, check_contrast=False)
            frames.append({"file_path": f"./{stage}/r_{k}", "transform_matrix": pose.tolist()})
        document = {"camera_angle_x": 2 * camera.half_angle, "frames": frames}
        (folder / FOLDER / f"transforms_{stage}.json").write_text(json.dumps(document, indent=1))


def main() -> None:
    """`python -m pixelid.nerf.synthetic SETTING OUT [--seed N] [--side N]`: write a dataset."""
    import argparse

    parser = argparse.ArgumentParser(description="Write a dataset of a procedural scene.")
    parser.add_argument("setting", choices=list(SETTINGS))
    parser.add_argument("out", type=Path)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--side", type=int, default=64)
    parser.add_argument("--overwrite", action="store_true")
    parser.add_argument("--quiet", action="store_true", help="no progress")
    options = parser.parse_args()
    make_dataset(
        options.out,
        options.setting,
        seed=options.seed,
        side=options.side,
        overwrite=options.overwrite,
        progress=_progress_lines(options.quiet),
    )


def _progress_lines(quiet: bool) -> Callable[[str, float], None]:
    """What says each tenth of the work on stderr, where that is a terminal."""
    told: dict[str, int] = {}

    def report(what: str, share: float) -> None:
        step = int(10 * share)
        if told.get(what) != step and not quiet and sys.stderr.isatty():
            print(f"{what}: {share:.0%}", file=sys.stderr)
        told[what] = step

    return report


if __name__ == "__main__":
    main()
