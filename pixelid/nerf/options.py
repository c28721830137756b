"""What a caller may ask of a dataset, a reconstruction and its views: functions and commands read it from here."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from pixelid.options import Checked, option

BANDWIDTHS, BETWEEN_POSES, REGULARISATIONS = ("on", "off", "joint"), ("linear", "cubic"), ("usual", "auto")
SCALES, PROTOCOLS, DEVICES = ("auto", "level", "free"), ("strict", "paper"), ("auto", "cpu", "cuda")
TRAINABLE = (  # of the pixel, whatever is done about the filter: two factors, and `additions.ADDITIONS`
    "threshold", "ratio", "refractory", "leak", "parasitic_photocurrent", "threshold_drift", "polarity_memory",
)  # fmt: skip
HIGHEST_DEGREE = 2  # of the harmonics
AUTO = "auto"
STEPS, BATCH = 1200, 320
ALPHA = 0.01  # of naming or preferring by held-out events what is not better, all that are compared together
# Of the loss of held-out events; less is explained by what a coarse scene gets wrong (at most 0.5 % in clean cameras)
LEAST_SHARE = 0.01


@dataclass(frozen=True)
class Options(Checked):
    """How a scene is reconstructed.

    Raises:
        InputError: a value that its field does not allow.
    """

    fit: Path | None = option(
        None,
        "Folder of a fit or of gap, or a model or its file; its pixel replaces the dataset's.",
        also="ModelLike | FitResult | GapReport",
    )
    sensor: Path | None = option(None, "Folder of `pixelid sensor`: thresholds and bandwidth of each pixel.")
    bandwidth: str = option("on", "The pixel's filter: known, ignored, or trained with the scene.", choices=BANDWIDTHS)
    samples: int = option(
        30, "Past samples per event.", low=1, high=1000, why="experiment *samples* of docs/results/reconstruction.md"
    )
    trained: tuple[str, ...] = option(
        (),
        "Of the pixel, trained with the scene: mean threshold, ON/OFF ratio, dead time (refractory), or an effect.",
        choices=TRAINABLE,
        flags=("--train",),
    )
    between_poses: str = option(
        "linear",
        "The camera's way from pose to pose: at constant rates, or along cubic splines.",
        choices=BETWEEN_POSES,
    )
    refine_time: float | None = option(
        None, "Train an offset between the clocks of poses and events, known to SD seconds.", above=0.0, metavar="SD"
    )
    refine_poses: tuple[float, ...] | None = option(
        None,
        "Train smooth corrections of the poses, known to SD in the scene's unit and DEGREES.",
        low=0.0,
        count=2,
        metavar="SD DEGREES",
    )
    gap: bool = option(False, "Look in the events for effects that the pixel lacks, and train with those found.")
    beside: Path | None = option(None, "Folder of another reconstruction of the dataset, to compare with.")
    cells: int | None = option(
        None,
        "Cells of the field per side; by default one per pixel, 32 to 512.",
        low=8,
        high=512,
        why="513³ vertices of one colour with harmonics of degree 1 are 2.7 GB of values, where no brick is given up",
    )
    harmonics: int = option(
        1,
        "Degree of the harmonics by which colours depend on the direction; 0: they do not.",
        low=0,
        high=HIGHEST_DEGREE,
        why="highlights; experiment *harmonics* of docs/results/reconstruction.md",
    )
    iterations: int | str = option(
        STEPS,
        "Training steps; auto: steps and batch by the number of events.",
        low=1,
        high=1_000_000_000,
        word=AUTO,
        flags=("--steps", "--iterations"),
        why="chosen on scenes of 64 × 64 pixels with some 1e5 changes of light",
    )
    batch: int | None = option(
        None, f"Chains of events per step; {BATCH}, or what --steps auto chooses.", low=1, high=10_000_000
    )
    regularisation: str = option(
        "usual", "Smoothing; auto: ⅓, 1 or 3 × usual, chosen on held-out events.", choices=REGULARISATIONS
    )
    background: float | None = option(None, "Radiance behind the scene; by default what the views show.", above=0.0)
    scale: str = option(
        "auto", "What pins the radiance unit; auto: the views' background, else their level.", choices=SCALES
    )
    box: tuple[float, ...] | None = option(
        None, "Corners of the scene; by default a cube where the views look.", count=6, metavar="X0 Y0 Z0 X1 Y1 Z1"
    )
    near: float = option(0.0, "Distance from the camera before which nothing is, in the unit of the poses.", low=0.0)
    unbounded: bool = option(False, "The scene goes on beyond the box: space is held to the horizon, ever coarser.")
    radiance_scale: float | None = option(
        None, "The fit's radiance units per unit of the views; by default from q_in.", above=0.0
    )
    protocol: str = option(
        "strict", "paper: also the reference implementation's scores, corrected on the scored views.", choices=PROTOCOLS
    )
    device: str = option("auto", "Where the scene is trained.", choices=DEVICES)
    seed: int = option(0, "Of everything random.", low=0, high=2**32 - 1)


@dataclass(frozen=True)
class DatasetOptions(Checked):
    """What is kept of a published sequence, and what is stated about it.

    Raises:
        InputError: a value that its field does not allow.
    """

    start: float | None = option(None, "Begin S seconds after the first pose.", low=0.0, high=1e9, metavar="S")
    end: float | None = option(None, "End S seconds after the first pose.", above=0.0, high=1e9, metavar="S")
    every: int = option(
        1, "Keep one pixel in N, with all of its events.", low=1, high=1 << 24, metavar="N",
        why="a pixel that misses events is not understood",
    )  # fmt: skip
    views: int = option(
        40,
        "At most N pictures as views to compare with, but all posed views that come with a sequence; 0: none.",
        low=0,
        high=1_000_000,
        metavar="N",
    )
    camera: str = option(
        "",
        "esim: first word of the topics; eds: the sensor's name in the calibration; tumvie: left or right.",
        metavar="NAME",
    )
    time_offset: float = option(0.0, "Added to the events' times.", low=-1e9, high=1e9, metavar="S")
    on_threshold: float | None = option(None, "In place of the one known or assumed.", above=0.0, high=1e9)
    off_threshold: float | None = option(None, "In place of the one known or assumed.", above=0.0, high=1e9)
    dead_time: float | None = option(None, "In place of the one known or assumed.", low=0.0, high=1e9, metavar="S")
    seed: int = option(0, "Of the pixels that --every keeps.", low=0, high=2**32 - 1)


@dataclass(frozen=True)
class RenderOptions(Checked):
    """From where a reconstruction is seen, and what is made of it.

    Raises:
        InputError: a value that its field does not allow.
    """

    views: Path | None = option(
        None, "Where from: transforms_*.json, a dataset folder, or camera_poses.npz.", metavar="FILE"
    )
    path: str | None = option(None, "Around the scene.  [default: orbit]", choices=("orbit", "spiral"))
    frames: int = option(60, "On the path; at most so many of --views.", low=1, high=10_000)
    size: tuple[int, ...] | None = option(
        None, "Pixels.  [default: 400 400, or those of --views]", low=1, high=8192, count=2, metavar="W H"
    )
    fov: float | None = option(
        None, "Horizontal, degrees, where --views states no camera.  [default: 39.6]", low=1.0, high=170.0
    )
    up: tuple[float, ...] = option((0.0, 0.0, 1.0), "What is up in the scene, for --path.", count=3, metavar="X Y Z")
    distance: float | None = option(
        None, "Of the camera from the middle, for --path; by default the box fills the view.", above=0.0
    )
    supersample: int = option(1, "Rays per pixel and side.", low=1, high=8)
    video: bool = option(False, "An mp4 of the frames (with pixelid[video]).")
    fps: int = option(30, "Of the video.", low=1, high=240)
    depth: bool = option(False, "Distances too, as arrays and pictures.")
    mesh: bool = option(False, "The surface as mesh.ply.")
    splats: bool = option(False, "Gaussian splats as splats.ply.")
