"""What `make fuzz` damages: every kind of file that the package reads, with good examples of it.

Good files are made here, by other means than the package's own writers where there are any, or lie in tests/data.
"""

from __future__ import annotations

import contextlib
import json
import math
import shutil
import struct
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pixelid.cli.main import main
from pixelid.errors import InputError

ROOT = Path(__file__).resolve().parents[1]


@dataclass(frozen=True)
class Target:
    """A parser: good files of it by suffix, and how it is called (with the path of a damaged one)."""

    name: str
    suffix: str
    originals: tuple[bytes, ...]
    call: Callable[[Path], object]


def targets(folder: Path) -> dict[str, Target]:
    """Every parser by name; `folder` receives the files that targets need beside the damaged one."""
    found = [
        *_documents(folder),
        *_results(folder),
        *_recordings(folder),
        *_foreign(folder),
        *_cameras(folder),
        *_kept(folder),
        *_scenes(folder),
    ]
    return {target.name: target for target in found}


def _documents(folder: Path) -> Iterator[Target]:
    from pixelid.design.menu import read_menu
    from pixelid.fit.recipe import read_recipe
    from pixelid.stimuli.files import load_stimulus
    from pixelid.tables.latency.reading import read_tables
    from pixelid.tables.noise.reading import read_noise_tables
    from pixelid.tables.rates.reading import read_table
    from pixelid.tables.rates.recipe import read_pool_recipe

    def command(path: Path) -> int:
        return main(["models", str(path)])

    def recipe(path: Path) -> None:
        read = read_recipe(path)
        read.prepared_model()
        read.prepared_gauge()

    models = tuple(path.read_bytes() for path in sorted((ROOT / "models").glob("*.toml")))
    yield Target("model", ".toml", models, command)
    more = b'with = ["leak:rate_hz=0.1"]\nfix = ["gamma=1.12"]\ngauge = ["q_in=0.875", "A_loop=0.7 A_amp"]\n'
    more += b'between = "auto"\nengine = "casadi"\nseed = 3\nroi = [0, 0, 4, 4]\ntime = [0.1, 0.5]\npixels = 3\n'
    recipe_file = b'[fit]\nrecordings = ["a.h5"]\nmodel = "dvs128"\n'
    yield Target("recipe", ".toml", (recipe_file + more, recipe_file), recipe)
    kinds = ("constant", "sine", "slow", "chirp", "steps", "pulse", "edge", "grating")
    entries = [f'kind = "{kind}"\nlevel = 24.0\nduration_s = 0.05\nstart_s = 0.1\n'.encode() for kind in kinds]
    samples = b'[stimulus]\nkind = "samples"\nt = [0.0, 0.1, 0.2]\nradiance = [1.0, 2.0, 3]\nunit = "lux"\n'
    light = b"time_ms,radiance_lux\n# unit: lux\n0,10\n1,11.5\n2,12\n3,11\n"
    (folder / "light.csv").write_bytes(light)
    file = b'[stimulus]\nkind = "file"\npath = "light.csv"\nunit = "lux"\ntime_unit = "s"\n'
    steps = b'[stimulus]\nkind = "steps"\nhold_s = 0.02\nedge_s = 0.0002\nduration_s = 0.1\ndt = 0.00005\nseed = 1\n'
    yield Target("stimulus", ".toml", (*(b"[stimulus]\n" + e for e in entries), samples, file, steps), load_stimulus)
    yield Target("light table", ".csv", (light, b"t;light [fA]\n0;1\n.1;2\n.2;3\n"), load_stimulus)
    menu = b"".join(
        b"[[stimulus]]\nname = 'n%d'\n%s\n" % (k, e.replace(b"start_s = 0.1\n", b"")) for k, e in enumerate(entries[:7])
    )
    yield Target("menu", ".toml", (menu,), read_menu)
    np.savez(folder / "pool.npz", mean=np.ones((2, 3)), spread=np.full((2, 3), 0.1))
    pool = b'[rates]\ntable = "pool.npz"\nfrequency_hz = [5.0, 12.5, 25]\nconditions = ["a", "b"]\n'
    pool += b'arrays = [{ mean = "mean", spread = "spread", label = "near" }]\n'
    yield Target("pool recipe", ".toml", (pool,), read_pool_recipe)
    yield Target("rate table", ".csv", (b"# rates\nfreq_hz,slow,fast\n1,70,80\n10,300,\n50,100.5,200\n",), read_table)
    edges = b"camera,lens,polarity,irradiance_W_m2,bias_config,median,stdev,pixels\n"
    edges += b"evk4,f2,1,0.5,default,210,3,100\nevk4,f2,0,0.5,default,310,4,100\nevk4,f2,1,5,fast,60,2,\n"
    yield Target("latency table", ".csv", (edges,), lambda path: read_tables([path]))
    noise = b"# still\nlux,ON_events_per_s_per_px,OFF_events_per_s_per_px\n1,2.5,0.1\n10,0.5,\n100,0.125,0.02\n"
    yield Target("noise table", ".csv", (noise,), lambda path: read_noise_tables([path]))
    t = np.linspace(0, 1, 20)
    for suffix, save in (
        (".npy", lambda f: np.save(f, np.stack([t, t + 1]))),
        (".npz", lambda f: np.savez(f, t=t, radiance=t + 1)),
    ):
        save(folder / f"light{suffix}")
        yield Target(f"light {suffix}", suffix, ((folder / f"light{suffix}").read_bytes(),), load_stimulus)


def _results(folder: Path) -> Iterator[Target]:
    from pixelid.fit.draws import read_fit, uncertainty
    from pixelid.fit.result import FitResult
    from pixelid.gap.result import GapReport
    from pixelid.model.files import load_model

    def loaded(name: str, load: Callable[[Path], object]) -> Callable[[Path], int]:
        def command(path: Path) -> int:
            result = folder / name
            result.mkdir(exist_ok=True)
            (result / f"{name}.json").write_bytes(path.read_bytes())
            (result / "model.toml").write_bytes((ROOT / "models" / "dvs128.toml").read_bytes())
            code = main(["report", str(result), "--quiet"])
            with contextlib.suppress(InputError):
                repr(load(result))
            return code

        return command

    def fit(result: Path) -> object:
        with contextlib.suppress(InputError):
            fitted = read_fit(result)
            assert fitted is not None
            uncertainty(fitted, load_model(result / "model.toml"))
        return FitResult.load(result)

    for file in sorted((ROOT / "tests/data/results").glob("*.json")):
        yield Target(file.name, ".json", (file.read_bytes(),), loaded(file.stem, lambda result: None))
    yield Target("fit.json", ".json", ((ROOT / "tests/data/fit.json").read_bytes(),), loaded("fit", fit))
    yield Target("gap.json", ".json", ((ROOT / "tests/data/gap.json").read_bytes(),), loaded("gap", GapReport.load))


def _recordings(folder: Path) -> Iterator[Target]:
    from pixelid.recordings import Events, Recording, open_recording, write_recording
    from pixelid.stimuli.shapes import steps

    chance = np.random.default_rng(0)
    t = np.sort(chance.integers(0, 700_000_000, 60))
    events = Events.from_columns(
        t, chance.integers(0, 4, 60), chance.integers(0, 4, 60), chance.integers(0, 2, 60), 4, 4
    )
    recording = Recording(events, steps(20.0, duration_s=0.8), "a", "b", attributes={"biases": {"diff": 80}})
    for suffix in (".h5", ".npz", ".csv"):
        write_recording(recording, folder / f"r{suffix}")
        yield Target(f"recording {suffix}", suffix, ((folder / f"r{suffix}").read_bytes(),), open_recording)
    words = [0x8000, 0x600A, 0xA201, 0x0005, 0x2807, 0x6014, 0xA200, 0x601E, 0x3864, 0x4005]
    raw = b"% evt 3.0\n% geometry 640x480\n% end\n" + np.array(words, "<u2").tobytes()
    yield Target("recording .raw", ".raw", (raw,), open_recording)
    head = b"#!AER-DAT2.0\r\n# HARDWARE INTERFACE: DAVIS240C\r\n# AEChip: eu.seebetter.ini.chips.davis.DAVIS240C\r\n"
    addresses = (
        (chance.integers(0, 180, 50) << 22) | (chance.integers(0, 240, 50) << 12) | (chance.integers(0, 2, 50) << 11)
    )
    records = np.stack([addresses, np.arange(50) * 100], axis=1).astype(">u4").tobytes()
    yield Target("recording .aedat", ".aedat", (head + records,), open_recording)
    dat = b"% Height 480\n% Width 640\n% Version 2\n% end\n" + bytes([12, 8])
    rows = np.stack([np.arange(40) * 100, (chance.integers(0, 640, 40)) | (chance.integers(0, 480, 40) << 14)], axis=1)
    yield Target("recording .dat", ".dat", (dat + rows.astype("<u4").tobytes(),), open_recording)


def _foreign(folder: Path) -> Iterator[Target]:
    """Files of other programs: dialects of text, what they state beside the events, COLMAP's cameras, biases."""
    from pixelid.nerf.shown.ways import way_of_file
    from pixelid.recordings import open_recording
    from pixelid.recordings.bias_files import biases_beside
    from pixelid.stimuli.files import load_stimulus

    texts = [
        "%geometry:64,48\n5,3,0,1190\n63,47,1,2322\n9,4,1,3465\n",
        "# timestamps in ns\nt,x,y,p\n1190,5,3,ON\n2322,9,4,OFF\n",
        "t [\xb5s];x;y;p\n1190,5;5;3;True\n2322,25;9;4;False\n", "64 48\n[0.00119, 5, 3, -1]\n[0.0023, 9, 4, 1]\n",
    ]  # fmt: skip
    contents = tuple(text.encode("latin1") for text in texts)
    yield Target("foreign text", ".csv", contents, open_recording)
    t, x, p = np.array([1190, 2322, 3465]), np.array([5, 63, 9], np.uint16), np.array([0, 1, 1], np.uint8)
    np.savez(folder / "f.npz", ts=t, xs=x, ys=x, ps=p, time_unit="us", resolution=np.array([640, 480]))
    np.save(folder / "f.npy", np.stack([t, x, x, p]))
    for suffix in (".npz", ".npy"):
        yield Target(f"foreign {suffix}", suffix, ((folder / f"f{suffix}").read_bytes(),), open_recording)
    scope = "X,CH1,Start,Increment,\nSequence,Volt,0.0,2.5e-3\n0,1.0,\n1,1.5,\n"
    dated = "timestamp,lux\n2024-01-01 12:00:00.000,1\n2024-01-01 12:00:00.002,2\n"
    german = '"Zeit [ms]","U [V]"\n"0,5","1,5"\n"1,0","2,5"\n'
    lights = tuple(text.encode() for text in (scope, dated, german))
    yield Target("foreign light", ".csv", lights, load_stimulus)
    colmap = folder / "colmap"
    colmap.mkdir()
    (colmap / "cameras.txt").write_text("1 OPENCV 64 48 40 41 32 24 0.1 0 0 0\n")
    (colmap / "images.txt").write_text("1 1 0 0 0 0 0 3 1 a.png\n1 2 -1\n2 0.9 0 0.1 0 0 0 3 1 b.png\n\n")
    cameras = struct.pack("<QiiQQ4d", 1, 1, 1, 64, 48, 40.0, 41.0, 32.0, 24.0)
    images = struct.pack("<Qi7di", 1, 1, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 3.0, 1) + b"a.png\0" + struct.pack("<Q", 0)
    (colmap / "cameras.bin").write_bytes(cameras)
    (colmap / "images.bin").write_bytes(images)

    def replaced(name: str) -> Callable[[Path], object]:
        def read(path: Path) -> object:
            content = (colmap / name).read_bytes()
            (colmap / name).write_bytes(path.read_bytes())
            try:
                return way_of_file(colmap / f"images{path.suffix}", None)
            finally:
                (colmap / name).write_bytes(content)

        return read

    for name in ("cameras.txt", "images.txt", "cameras.bin", "images.bin"):
        yield Target(f"colmap {name}", Path(name).suffix, ((colmap / name).read_bytes(),), replaced(name))
    biases = (
        b"299  % bias_diff\n% system_ID 28\n",
        b'{"ll_biases_state": {"bias": [{"name": "bias_fo", "value": 1}]}}',
    )
    yield Target("biases", ".bias", biases, biases_beside)


def _cameras(folder: Path) -> Iterator[Target]:
    """Files of camera makers and of other programs."""
    import h5py
    from faery.extension import aedat, evt
    from scipy.io import savemat

    from pixelid.recordings import open_recording

    def target(name: str, path: Path) -> Target:
        return Target(f"recording {name}", path.suffix, (path.read_bytes(),), open_recording)

    chance, n = np.random.default_rng(1), 60
    t, x, y = np.sort(chance.integers(0, 90_000, n)), chance.integers(0, 30, n), chance.integers(0, 20, n)
    on = chance.integers(0, 2, n)
    packet = np.zeros(n, [("t", "<u8"), ("x", "<u2"), ("y", "<u2"), ("on", "?")])
    packet["t"], packet["x"], packet["y"], packet["on"] = t, x, y, on
    for compression in (None, ("lz4", 1), ("zstd", 1)):
        path = folder / "a.aedat4"
        with aedat.Encoder(path, _aedat_description(compression), compression) as encoder:
            encoder.write(0, packet)
        yield target(f"aedat4 {compression[0] if compression else 'raw'}", path)
    for version in ("evt2", "evt3"):
        path = folder / "b.raw"
        with evt.Encoder(path, version, False, (30, 20), True) as encoder:
            encoder.write({"events": packet})
        yield target(version, path)
    words = [(8 << 60) | (5 << 32), (1 << 60) | (3 << 54) | (8 << 43) | (4 << 32) | 0b101, (8 << 60) | (6 << 32)]
    words += [(10 << 60) | (1 << 54) | (1 << 32), (2 << 54) | (9 << 43) | (19 << 32) | 1]
    head = b"% evt 2.1\n% geometry 64x32\n% end\n"
    yield Target("recording evt2.1", ".raw", (head + np.array(words, "<u8").tobytes(),), open_recording)
    table = {"ts": t[:, None], "x": x[:, None] + 1, "y": y[:, None] + 1, "p": on[:, None]}
    for packed in (False, True):
        savemat(folder / "c.mat", {"TD": table, "EM": table}, do_compression=packed)
        yield target("mat packed" if packed else "mat", folder / "c.mat")
    with h5py.File(folder / "d.h5", "w") as file:
        file.attrs["geometry"] = "640x480"
        file["CD/events"] = np.rec.fromarrays(
            [x, y, on, t], dtype=[("x", "<u2"), ("y", "<u2"), ("p", "<i2"), ("t", "<i8")]
        )
        file["EXT_TRIGGER/events"] = np.array([(1, 500, 6), (0, 900, 6)], [("p", "<i2"), ("t", "<i8"), ("id", "<i2")])
    yield target("prophesee h5", folder / "d.h5")
    with h5py.File(folder / "e.h5", "w") as file:
        for name, column in (("t", t), ("x", x), ("y", y), ("p", on)):
            file.create_dataset(f"events/{name}", data=column, compression="gzip", shuffle=True, chunks=(16,))
        file["t_offset"], file["ms_to_idx"] = 1000, np.arange(5)
    yield target("dsec h5", folder / "e.h5")
    for path in _bags(folder, t * 1000 + 10**18, x, y, on):
        yield target(path.suffix[1:], path)


def _aedat_description(compression: tuple[str, int] | None) -> list:
    """What an AEDAT4 file says of its one stream of events."""
    from faery.extension import aedat

    attribute, node = aedat.DescriptionAttribute, aedat.DescriptionNode

    def texts(**values: str) -> dict:
        return {name: attribute(attribute_type="string", value=value) for name, value in values.items()}

    root = "/mainloop/Recorder/outInfo/"
    size = {name: attribute(attribute_type="int", value=value) for name, value in (("sizeX", 30), ("sizeY", 20))}
    info = node(name="info", path=f"{root}0/info/", attributes=size | texts(source="DVS"), nodes=[])
    packing = compression[0].upper() if compression else "NONE"
    stream = texts(compression=packing, originalOutputName="events", typeIdentifier="EVTS")
    nodes = [node(name="0", path=f"{root}0/", attributes=stream, nodes=[info])]
    return [node(name="outInfo", path=root, attributes={}, nodes=nodes)]


def _bags(folder: Path, t_ns, x, y, on) -> Iterator[Path]:
    """A bag of ROS 1, and two kinds of ROS 2, with one message of events in each."""
    from rosbags.rosbag1 import Writer as Ros1
    from rosbags.rosbag2 import StoragePlugin
    from rosbags.rosbag2 import Writer as Ros2
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    array = "std_msgs/Header header\nuint32 height\nuint32 width\ndvs_msgs/Event[] events\n"
    for store_of, time in ((Stores.ROS1_NOETIC, "time"), (Stores.ROS2_HUMBLE, "builtin_interfaces/Time")):
        store = get_typestore(store_of)
        store.register(get_types_from_msg(f"uint16 x\nuint16 y\n{time} ts\nbool polarity\n", "dvs_msgs/msg/Event"))
        store.register(get_types_from_msg(array, "dvs_msgs/msg/EventArray"))
        kinds, first = store.types, store_of is Stores.ROS1_NOETIC
        stamp = kinds["builtin_interfaces/msg/Time"]
        events = [
            kinds["dvs_msgs/msg/Event"](x=b, y=c, ts=stamp(sec=a // 10**9, nanosec=a % 10**9), polarity=bool(d))
            for a, b, c, d in zip(*(column.tolist() for column in (t_ns, x, y, on)), strict=True)
        ]
        more = {"seq": 0} if first else {}
        header = kinds["std_msgs/msg/Header"](stamp=stamp(sec=1, nanosec=2), frame_id="camera", **more)
        message = kinds["dvs_msgs/msg/EventArray"](header=header, height=20, width=30, events=events)
        name = "dvs_msgs/msg/EventArray"
        if first:
            with Ros1(folder / "f.bag") as bag:
                connection = bag.add_connection("/events", name, typestore=store)
                bag.write(connection, 1, bytes(store.serialize_ros1(message, name)))
            yield folder / "f.bag"
            continue
        for plugin in (StoragePlugin.SQLITE3, StoragePlugin.MCAP):
            with Ros2(folder / plugin.name, version=9, storage_plugin=plugin) as bag:
                connection = bag.add_connection("/events", name, typestore=store)
                bag.write(connection, 1, store.serialize_cdr(message, name))
            yield next(f for f in (folder / plugin.name).iterdir() if f.suffix in (".db3", ".mcap"))


def _kept(folder: Path) -> Iterator[Target]:
    """What runs keep to be continued: damaged files are set aside, and computed again."""
    import torch

    from pixelid.cluster import _kept, _sealed
    from pixelid.fit.cache import FitCache, _line
    from pixelid.nerf.training import checkpoint
    from pixelid.sample.ensembles import Ensembles
    from pixelid.sample.proposal import Proposal

    proposal = Proposal(np.zeros(2), np.eye(2), np.ones(2), np.ones(2), np.zeros(2), 0)
    starts = np.random.RandomState(5).normal(size=(2, 6, 2))

    def again(path: Path, use: Callable[[Path], object]) -> None:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            use(path)
        for left in path.parent.glob(f"{path.name}.*"):
            left.unlink()

    def chain(path: Path) -> Ensembles:
        ensembles = Ensembles(lambda x: (-0.5 * float(x @ x), x), starts, proposal, 0.5, 3, path, {"fit": 1})
        if ensembles.resumed:
            repr(ensembles.samplers[0].get_last_sample().coords if ensembles.steps else 0)
        return ensembles

    first = chain(folder / "chain.npz")
    first.advance(4)
    first.save()
    content = (folder / "chain.npz").read_bytes()
    yield Target("kept chain", ".npz", (content,), lambda path: again(path, chain))
    np.savez(folder / "0.npz", **_sealed({"pixel": np.arange(9), "on": np.ones(9)}, "a 0"))  # type: ignore[arg-type]
    content = (folder / "0.npz").read_bytes()
    yield Target("kept tile", ".npz", (content,), lambda path: again(path, lambda p: _kept(p, "a 0")))
    lines = [_line(f"k{k}", {"value": k, "x": [0.1, None]}) for k in range(3)]
    content = "\n".join(["", *lines]).encode()
    yield Target("kept fits", ".fits", (content,), lambda path: again(path, lambda p: FitCache(p).get("k1")))
    document = {"format": checkpoint.FORMAT, "mark": "m", "iteration": 1, "grid": torch.zeros(3, 3, 3, 2)}
    torch.save(document, folder / "state.pt")
    content = (folder / "state.pt").read_bytes()
    unknown: dict = dict.fromkeys(("problem", "recipe", "bandwidth"))
    yield Target(
        "kept checkpoint",
        ".pt",
        (content,),
        lambda path: again(path, lambda p: checkpoint.load(p, **unknown, mark="m")),
    )


def _scenes(folder: Path) -> Iterator[Target]:
    """A dataset of posed pictures and events, each of its files damaged in turn, and what is written of it."""
    from skimage.io import imsave

    from pixelid.nerf.data.dataset import read_dataset
    from pixelid.nerf.shown.saved import read_field

    scene = folder / "scene"
    (scene / "views").mkdir(parents=True)
    chance, n = np.random.default_rng(2), 40
    t = np.sort(chance.integers(10**6, 10**8, n))
    xy = chance.integers(0, 8, (n, 2))
    np.savez(scene / "raw_events.npz", position=xy, timestamp=t, polarity=chance.integers(0, 2, n).astype(bool))
    poses = {"T_wc_position": np.zeros((3, 3)), "T_wc_orientation": np.tile([0.0, 0, 0, 1], (3, 1))}
    np.savez(scene / "camera_poses.npz", T_wc_timestamp=np.array([0, 10**8, 2 * 10**8]), **poses)
    circuit = {
        "input_time_const_eff_it_prod": 1e-3, "miller_time_const_eff_it_prod": 1e-5, "black_level": 0.1,
        "amplifier_gain": 100.0, "closed_loop_gain": 2.0, "output_time_const": 1e-5, "lower_cutoff_freq": 0.0,
        "sf_cutoff_freq": 1e3, "diff_amp_cutoff_freq": 1e4, "pos_contrast_threshold": 0.25,
        "neg_contrast_threshold": 0.25, "refractory_period": 1000,
    }  # fmt: skip
    geometry = {
        "intrinsics": np.array([[8.0, 0, 4], [0, 8, 4], [0, 0, 1]]), "distortion_params": np.zeros(4), "img_height": 8,
        "img_width": 8, "distortion_model": "plumb_bob", "bayer_pattern": "",
    }  # fmt: skip
    np.savez(scene / "camera_calibration.npz", **circuit, **geometry)  # type: ignore[arg-type]
    np.savez(scene / "renderer_params.npz", interm_color_space="display", log_eps=1e-3)
    imsave(scene / "views" / "a.png", np.full((8, 8, 3), 100, np.uint8), check_contrast=False)
    frames = [{"file_path": "./a.png", "transform_matrix": np.eye(4).tolist(), "exposure_time": 1.0, "gain": 1}] * 2
    for stage in ("train", "val", "test"):
        document = {"camera_angle_x": math.pi / 3, "frames": frames}
        (scene / "views" / f"transforms_{stage}.json").write_text(json.dumps(document))

    def damaged(place: str) -> Callable[[Path], object]:
        def read(path: Path) -> object:
            here = folder / f"scene {Path(place).stem}"
            if not here.exists():
                shutil.copytree(scene, here)
            (here / place).write_bytes(path.read_bytes())
            return read_dataset(here)

        return read

    for place in ("raw_events.npz", "camera_poses.npz", "camera_calibration.npz", "renderer_params.npz", "views/a.png",
                  "views/transforms_val.json"):  # fmt: skip
        yield Target(f"scene {place}", Path(place).suffix, ((scene / place).read_bytes(),), damaged(place))
    grid = np.zeros((3, 3, 3, 2), np.float16)
    np.savez(folder / "field.npz", grid=grid, low=np.zeros(3), high=np.ones(3), background=np.ones(1))

    def field(path: Path) -> object:
        (folder / "result").mkdir(exist_ok=True)
        (folder / "result" / "field.npz").write_bytes(path.read_bytes())
        return read_field(folder / "result")

    yield Target("field.npz", ".npz", ((folder / "field.npz").read_bytes(),), field)
