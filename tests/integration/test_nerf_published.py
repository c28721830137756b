"""Published layouts, written here from the simulator's events, become datasets, and those reconstructions."""

import json
import re
import shutil
from pathlib import Path
from types import SimpleNamespace

import h5py
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pixelid.cli.main import main
from pixelid.errors import InputError
from pixelid.nerf.data.camera import Camera
from pixelid.nerf.data.dataset import read_dataset
from pixelid.nerf.data.published import esim, esim_flags, tumvie
from pixelid.nerf.data.published.posed_views import pinhole_of, undistorted
from pixelid.nerf.data.scenes import procedural
from pixelid.nerf.data.trajectory import Trajectory
from pixelid.nerf.options import DatasetOptions
from pixelid.nerf.synthetic import SETTINGS
from pixelid.stages.photoreceptor import NOMINAL

EPOCH_NS = 1_600_000_000_000_000_000
SIDE, SECONDS = 16, 0.25
LENS = (-0.1, 0.02, 0.001, -0.002)
CLOCK = 1e-4  # what the camera moves in the half microsecond to which decimal seconds since 1970 are known


@pytest.fixture(scope="module")
def truth(made) -> dict[str, np.ndarray]:
    """Events, poses and intrinsics as the simulator made them, and six frames on the way."""
    return as_simulated(made)


def as_simulated(made: Path) -> dict[str, np.ndarray]:
    """The arrays of a dataset of `SIDE` × `SIDE` pixels, and six frames on the way."""
    names = ("raw_events.npz", "camera_poses.npz", "camera_calibration.npz")
    arrays = {}
    for name in names:
        with np.load(made / name) as file:
            arrays |= {key: file[key] for key in file.files}
    t = arrays["T_wc_timestamp"]
    way = Trajectory(t * 1e-9, arrays["T_wc_position"], arrays["T_wc_orientation"])
    times = np.linspace(t[1], t[-2], 6).round().astype(np.int64)
    camera = Camera(arrays["intrinsics"], SIDE, SIDE, np.empty(0))
    images = procedural(3).render(camera, *way.at(times * 1e-9), 4)
    return arrays | {"frame_t": times, "frames": np.clip(images * 255, 0, 255).astype(np.uint8)}


# --- writers of the published layouts -----------------------------------------------------------------------------

RECORD = np.dtype([("x", "<u2"), ("y", "<u2"), ("s", "<u4"), ("ns", "<u4"), ("p", "u1")])


def write_bag(path: Path, truth, lens=(), model="plumb_bob", pose=True, images=True) -> Path:
    """As rpg_esim's RosbagWriter: /cam0/{events, pose, camera_info, image_raw}."""
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    store.register(get_types_from_msg("uint16 x\nuint16 y\ntime ts\nbool polarity\n", "dvs_msgs/msg/Event"))
    array = "std_msgs/Header header\nuint32 height\nuint32 width\ndvs_msgs/Event[] events\n"
    store.register(get_types_from_msg(array, "dvs_msgs/msg/EventArray"))
    kinds = store.types

    def header(t: int):
        stamp = kinds["builtin_interfaces/msg/Time"](sec=int(t // 10**9), nanosec=int(t % 10**9))
        return kinds["std_msgs/msg/Header"](seq=0, stamp=stamp, frame_id="map")

    t = truth["timestamp"] + EPOCH_NS
    rows = np.zeros(len(t), RECORD)
    rows["x"], rows["y"] = truth["position"].T
    rows["s"], rows["ns"], rows["p"] = t // 10**9, t % 10**9, truth["polarity"]
    with Writer(path) as bag:

        def topic(name: str, kind: str):
            return bag.add_connection(f"/cam0/{name}", kind, typestore=store)

        events = topic("events", "dvs_msgs/msg/EventArray")
        for k in range(0, len(t), 500):
            part = rows[k : k + 500]
            head = b"\0\0\0\0" + part["s"][-1].tobytes() + part["ns"][-1].tobytes() + b"\0\0\0\0"
            size = np.array([SIDE, SIDE, len(part)], "<u4").tobytes()
            bag.write(events, int(t[k : k + 500][-1]), head + size + part.tobytes())
        if pose:
            connection = topic("pose", "geometry_msgs/msg/PoseStamped")
            for time, position, q in zip(
                truth["T_wc_timestamp"] + EPOCH_NS, truth["T_wc_position"], truth["T_wc_orientation"], strict=True
            ):
                where = kinds["geometry_msgs/msg/Pose"](
                    position=kinds["geometry_msgs/msg/Point"](*position.tolist()),
                    orientation=kinds["geometry_msgs/msg/Quaternion"](*q.tolist()),
                )
                message = kinds["geometry_msgs/msg/PoseStamped"](header=header(time), pose=where)
                bag.write(connection, int(time), store.serialize_ros1(message, "geometry_msgs/msg/PoseStamped"))
        K = np.asarray(truth["intrinsics"], float)
        region = kinds["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
        info = kinds["sensor_msgs/msg/CameraInfo"](
            header=header(EPOCH_NS), height=SIDE, width=SIDE, distortion_model=model, D=np.array(lens, float),
            K=K.ravel(), R=np.eye(3).ravel(), P=np.column_stack([K, np.zeros(3)]).ravel(), binning_x=0, binning_y=0,
            roi=region,
        )  # fmt: skip
        bag.write(
            topic("camera_info", "sensor_msgs/msg/CameraInfo"), EPOCH_NS,
            store.serialize_ros1(info, "sensor_msgs/msg/CameraInfo"),
        )  # fmt: skip
        if images:
            connection = topic("image_raw", "sensor_msgs/msg/Image")
            for time, image in zip(truth["frame_t"] + EPOCH_NS, truth["frames"], strict=True):
                message = kinds["sensor_msgs/msg/Image"](
                    header=header(time), height=SIDE, width=SIDE, encoding="mono8", is_bigendian=0, step=SIDE,
                    data=image.ravel(),
                )  # fmt: skip
                bag.write(connection, int(time), store.serialize_ros1(message, "sensor_msgs/msg/Image"))
    return path


def write_events(path: Path, truth, offset_us: int = 0, **storage) -> None:
    """Columns in µs since 1970, of which `offset_us` is in t_offset."""
    t = (truth["timestamp"] + EPOCH_NS) // 1000 - offset_us
    with h5py.File(path, "w") as file:
        for name, column in (("x", truth["position"][:, 0]), ("y", truth["position"][:, 1]), ("t", t)):
            file.create_dataset(f"events/{name}", data=column, **storage)
        file.create_dataset("events/p", data=truth["polarity"].astype(np.uint8), **storage)
        if offset_us:
            file["t_offset"] = offset_us


def write_pictures(folder: Path, pattern: str, images) -> list[str]:
    from skimage.io import imsave

    folder.mkdir(parents=True)
    names = [pattern.format(k) for k in range(len(images))]
    for name, image in zip(names, images, strict=True):
        imsave(folder / name, image, check_contrast=False)
    return names


def transform(position, rotvec) -> np.ndarray:
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = Rotation.from_rotvec(rotvec).as_matrix(), position
    return out


BESIDE = transform([0.02, -0.01, 0.005], [0.01, -0.02, 0.03])  # from the other camera to the sensor
SENSOR_IN_IMU = transform([0.1, 0.05, -0.02], [0.3, 1.2, -0.4])
MARKER_IN_IMU = transform([-0.2, 0.03, 0.04], [-0.7, 0.2, 0.9])


def poses_of(truth) -> np.ndarray:
    out = np.tile(np.eye(4), (len(truth["T_wc_timestamp"]), 1, 1))
    out[:, :3, :3] = Rotation.from_quat(truth["T_wc_orientation"]).as_matrix()
    out[:, :3, 3] = truth["T_wc_position"]
    return out


def write_poses(path: Path, t, poses) -> None:
    quaternions = Rotation.from_matrix(poses[:, :3, :3]).as_quat()
    np.savetxt(path, np.column_stack([t, poses[:, :3, 3], quaternions]), header="t px py pz qx qy qz qw", fmt="%.9f")


def write_eds(folder: Path, truth, lens=(0.0, 0.0, 0.0, 0.0)) -> Path:
    """events.h5, stamped_groundtruth.txt, images/ with their times, and Kalibr's chain."""
    folder.mkdir()
    write_events(folder / "events.h5", truth)
    write_poses(folder / "stamped_groundtruth.txt", (truth["T_wc_timestamp"] + EPOCH_NS) * 1e-9, poses_of(truth))
    names = write_pictures(folder / "images", "frame_{:010d}.png", truth["frames"])
    t = truth["frame_t"] + EPOCH_NS
    np.savetxt(folder / "images_timestamps.txt", t // 1000, fmt="%d")
    rows = [f"{k} {s * 1e-9:.6f} 10.0 {6 * (k % 2)} {name}" for k, (s, name) in enumerate(zip(t, names, strict=True))]
    (folder / "times.txt").write_text("\n".join(["# id timestamp exposure gain image", *rows]) + "\n")
    K = np.asarray(truth["intrinsics"], float)
    entry = f"  camera_model: pinhole\n  intrinsics: [{K[0, 0]}, {K[1, 1]}, {K[0, 2]}, {K[1, 2]}]\n"
    entry += f"  distortion_model: radtan\n  resolution: [{SIDE}, {SIDE}]\n"
    way = "".join(f"  - {row}\n" for row in BESIDE.tolist())
    text = f"cam0:\n{entry}  distortion_coeffs: [0.0, 0.0, 0.0, 0.0]\n  rostopic: /rgb/image\n"
    text += f"cam1:\n  T_cn_cnm1:\n{way}{entry}  distortion_coeffs: {list(lens)}\n  rostopic: /event/image\n"
    (folder / "camchain-e2kalibr.yaml").write_text(text)
    return folder


def write_tumvie(folder: Path, truth, **storage) -> Path:
    """NAME-events_left.h5 beside NAME-vi_gt_data/, with the two calibrations of Basalt."""
    data = folder / "mocap-desk2-vi_gt_data"
    write_pictures(data / "left_images", "{:05d}.jpg", truth["frames"])
    np.savetxt(data / "left_images" / "image_timestamps_left.txt", (truth["frame_t"] + EPOCH_NS) / 1000, fmt="%.3f")
    write_events(folder / "mocap-desk2-events_left.h5", truth, **storage)
    markers = poses_of(truth) @ np.linalg.inv(SENSOR_IN_IMU) @ MARKER_IN_IMU
    write_poses(data / "mocap_data.txt", (truth["T_wc_timestamp"] + EPOCH_NS) / 1000, markers)
    K = np.asarray(truth["intrinsics"], float)
    lens = {"fx": K[0, 0], "fy": K[1, 1], "cx": K[0, 2], "cy": K[1, 2], "k1": 0.01, "k2": 0.002, "k3": 0.0, "k4": 0.0}
    in_imu = [pose_entry(SENSOR_IN_IMU @ BESIDE)] * 2 + [pose_entry(SENSOR_IN_IMU)] * 2
    calibration = {
        "T_imu_cam": in_imu,
        "intrinsics": [{"camera_type": "kb4", "intrinsics": lens}] * 4,
        "resolution": [[SIDE, SIDE]] * 4,
    }
    (folder / "camera-calibrationA.json").write_text(json.dumps({"value0": calibration}))
    marker = {"value0": {"T_imu_marker": pose_entry(MARKER_IN_IMU)}}
    (folder / "mocap-imu-calibrationA.json").write_text(json.dumps(marker))
    return folder


def pose_entry(pose) -> dict[str, float]:
    numbers = [*pose[:3, 3], *Rotation.from_matrix(pose[:3, :3]).as_quat()]
    return dict(zip(("px", "py", "pz", "qx", "qy", "qz", "qw"), map(float, numbers), strict=True))


# --- what comes out ----------------------------------------------------------------------------------------------


def same_events(data, truth, tick_ns: int = 1) -> None:
    shift = truth["T_wc_timestamp"][0]
    np.testing.assert_allclose(data.t, (truth["timestamp"] // tick_ns * tick_ns - shift) * 1e-9, atol=2e-9)
    np.testing.assert_array_equal(np.column_stack([data.x, data.y]), truth["position"])
    np.testing.assert_array_equal(data.on, truth["polarity"])


def same_way(data, truth, atol: float = 1e-6) -> None:
    times = np.linspace(0.01, SECONDS - 0.01, 20)
    shift = truth["T_wc_timestamp"]
    way = Trajectory((shift - shift[0]) * 1e-9, truth["T_wc_position"], truth["T_wc_orientation"])
    for found, expected in zip(data.trajectory.at(times), way.at(times), strict=True):
        np.testing.assert_allclose(found, expected, atol=atol)


def test_a_bag_becomes_a_scored_reconstruction(truth, tmp_path, capsys):
    bag = write_bag(tmp_path / "esim.bag", truth)
    assert main(["dataset", "esim", str(bag), str(tmp_path / "scene")]) == 0
    printed = capsys.readouterr().out
    assert "--bandwidth off" in printed
    data = read_dataset(tmp_path / "scene")
    same_events(data, truth)
    same_way(data, truth)
    np.testing.assert_allclose(data.calibration.camera.intrinsics, truth["intrinsics"])
    assert {stage: len(views) for stage, views in data.views.items()} == {"val": 3, "test": 3}
    np.testing.assert_allclose(data.views["test"].images[0, ..., 0], (truth["frames"][1] + 0.5) / 256, atol=1e-6)
    words = ["reconstruct", str(tmp_path / "scene"), "--out", str(tmp_path / "out"), "--quiet"]
    assert main(words) == 2
    assert "--fit, or --bandwidth off" in capsys.readouterr().err
    assert main([*words, "--bandwidth", "off", "--iterations", "30"]) in (0, 1)
    scores = json.loads((tmp_path / "out" / "reconstruction.json").read_text())["views"]
    assert len(scores["per_view"]) == 3
    assert 5 < scores["psnr"] < 60
    assert (tmp_path / "scene" / "report.html").is_file()
    assert main(["dataset", "esim", str(bag), str(tmp_path / "scene"), "--quiet"]) == 2
    assert main(["dataset", "esim", str(bag), str(tmp_path / "scene"), "--quiet", "--overwrite"]) == 0


@pytest.mark.parametrize(
    ("encoding", "order"), [("rgba8", (0, 1, 2)), ("bgra8", (2, 1, 0)), ("8UC4", (2, 1, 0)), ("bgr8", (2, 1, 0))]
)
def test_colours_of_a_bag_come_without_alpha(encoding, order):
    stored = np.random.default_rng(0).integers(0, 256, (3, 5, 3 if encoding == "bgr8" else 4), np.uint8)
    rows = np.pad(stored.reshape(3, -1), ((0, 0), (0, 2)))  # bytes that fill up a row
    message = SimpleNamespace(
        encoding=encoding, is_bigendian=0, width=5, height=3, step=rows.shape[1], data=rows.ravel()
    )
    np.testing.assert_array_equal(esim._image("bag", message), stored[..., list(order)])


def test_what_is_written_is_what_the_schema_says(truth, tmp_path):
    from test_schemas import check

    bag = write_bag(tmp_path / "esim.bag", truth)
    assert main(["dataset", "esim", str(bag), str(tmp_path / "scene"), "--quiet", "--end", "0.1"]) == 0
    check("dataset", json.loads((tmp_path / "scene" / "dataset.json").read_text()))


def test_flags_and_views_beside_a_bag_make_a_complete_dataset(made, truth, tmp_path):
    """The circuit of `esim.conf` is the one that the simulator's own dataset quotes."""
    folder = tmp_path / "sequence"
    folder.mkdir()
    write_bag(folder / "esim.bag", truth, images=False)
    shutil.copytree(made / "views", folder / "views")
    white = SETTINGS["hard"].white_fa
    flags = {
        "contrast_threshold_pos": 0.25, "contrast_threshold_neg": 0.25, "refractory_period_ns": 100000,
        "I_p_to_intensity_ratio_fa": white, "dark_current_fa": SETTINGS["hard"].dark_fa,
        "amplifier_gain": NOMINAL.A_amp, "back_gate_coeff": NOMINAL.A_loop / NOMINAL.A_amp,
        "photodiode_cap_ff": NOMINAL.q_in / 0.025, "miller_cap_ff": NOMINAL.q_mil / 0.025,
        "output_time_const_us": 1e6 * NOMINAL.tau_out, "sf_cutoff_freq_hz": 3122, "diff_amp_cutoff_freq_hz": 16000,
        "renderer_type": 4, "blender_interm_color_space": 1, "log_eps": 0.0,
    }  # fmt: skip
    (folder / "esim.conf").write_text("\n".join(f"--{name}={value}" for name, value in flags.items()) + "\n")
    assert main(["dataset", "esim", str(folder), str(tmp_path / "scene"), "--quiet"]) == 0
    data, expected = read_dataset(tmp_path / "scene"), read_dataset(made)
    assert data.calibration.known
    found = data.calibration.circuit
    for name in ("alpha", "beta", "gamma", "follower", "differencing", "dark", "on_threshold", "refractory"):
        assert getattr(found, name) == pytest.approx(getattr(expected.calibration.circuit, name), rel=1e-9)
    for stage, views in expected.views.items():
        np.testing.assert_array_equal(data.views[stage].images, views.images)
        assert data.views[stage].names == views.names
    (spread,) = json.loads((tmp_path / "scene" / "dataset.json").read_text())["notes"]
    assert "differ by default by 0.021" in spread


def flags_in(folder: Path, *lines: str) -> tuple[Path, dict[str, str]]:
    conf = folder / "esim.conf"
    conf.write_text("\n".join(lines) + "\n")
    return conf, esim_flags.read_flags(conf)


EXACT = ("--contrast_threshold_sigma_pos=0", "--contrast_threshold_sigma_neg=0")


@pytest.mark.parametrize(
    ("lines", "says"),
    [
        (EXACT, []),
        ((*EXACT, "--leak_rate_hz=0.5"), ["leak of 0.5 ON thresholds a second .* --train leak, --gap, or --fit"]),
        (EXACT[1:], ["by default by 0.021 in their ON and 0 in .* --gap, or --fit with .* threshold_mismatch"]),
        (("--contrast_threshold_sigma_neg=0.03", EXACT[0]), ["differ by 0 in their ON and 0.03 in"]),
        (("--leak_rate_hz=2",), ["leak of 2 ON", "0.021 in their ON and 0.021 in their OFF"]),
    ],
)
def test_what_acts_in_the_simulator_and_not_in_the_dataset_is_told(lines, says, tmp_path):
    notes = esim_flags.notes_of(*flags_in(tmp_path, *lines))
    assert len(notes) == len(says)
    for note, pattern in zip(notes, says, strict=True):
        assert re.search(pattern, note)


def test_a_lower_cutoff_alone_is_a_circuit(tmp_path):
    assert esim_flags.pixel_of(*flags_in(tmp_path, "--lower_cutoff_freq_hz=0.01"))["lower_cutoff_freq"] == 0.01
    assert "lower_cutoff_freq" not in esim_flags.pixel_of(*flags_in(tmp_path, "--refractory_period_ns=1000"))


def test_events_of_images_without_a_logarithm_are_refused(tmp_path):
    esim_flags.pixel_of(*flags_in(tmp_path, "--use_log_image=1"))
    with pytest.raises(InputError, match=r"esim\.conf: --use_log_image: expected true, found '0'"):
        esim_flags.pixel_of(*flags_in(tmp_path, "--use_log_image=0"))
    with pytest.raises(InputError, match="expected true or false, found 'perhaps'"):
        esim_flags.pixel_of(*flags_in(tmp_path, "--use_log_image=perhaps"))
    with pytest.raises(InputError, match="--use_log_image: expected true"):
        esim_flags.pixel_of(*flags_in(tmp_path, "--nouse_log_image"))


@pytest.mark.parametrize("value", ["0", "-0.25", "inf", "nan", "", "x"])
@pytest.mark.parametrize("polarity", ["pos", "neg"])
def test_thresholds_that_are_none_are_refused_where_they_are_read(polarity, value, tmp_path):
    name = f"--contrast_threshold_{polarity}"
    with pytest.raises(InputError, match=rf"esim\.conf: {name}: expected a number above 0, finite, found '{value}'"):
        esim_flags.pixel_of(*flags_in(tmp_path, f"{name}={value}"))


def test_what_is_left_out_of_a_circuit_is_infinite(tmp_path):
    """Cutoffs are; a dark current is not, and is none by 0."""
    pixel = esim_flags.pixel_of(*flags_in(tmp_path, "--sf_cutoff_freq_hz=inf", "--dark_current_fa=0"))
    assert pixel["sf_cutoff_freq"] == np.inf
    with pytest.raises(InputError, match="--dark_current_fa: expected a number of at least 0, finite, found 'inf'"):
        esim_flags.pixel_of(*flags_in(tmp_path, "--dark_current_fa=inf"))
    with pytest.raises(InputError, match="--sf_cutoff_freq_hz: expected a number above 0, found '0'"):
        esim_flags.pixel_of(*flags_in(tmp_path, "--sf_cutoff_freq_hz=0"))


@pytest.mark.parametrize(
    ("lines", "bayer"),
    [
        (("--simulate_color_events", "--nosimulate_color_events"), ""),
        (("--nosimulate_color_events", "-simulate_color_events"), "RGGB"),
        (("--simulate_color_events=Yes",), "RGGB"),
        (("--simulate_color_events=f",), ""),
    ],
)
def test_the_last_of_a_flag_and_its_negation_counts(lines, bayer, tmp_path):
    assert esim_flags.pixel_of(*flags_in(tmp_path, *lines))["bayer_pattern"] == bayer


def test_start_end_and_every_choose_whole_pixels_of_a_time(truth, tmp_path):
    bag = write_bag(tmp_path / "esim.bag", truth)
    words = ["--start", "0.05", "--end", "0.2", "--every", "2", "--views", "2", "--seed", "5", "--quiet"]
    assert main(["dataset", "esim", str(bag), str(tmp_path / "scene"), *words]) == 0
    data = read_dataset(tmp_path / "scene")
    t = truth["timestamp"] - truth["T_wc_timestamp"][0]
    inside = (t >= 5e7) & (t <= 2e8)
    pixel = truth["position"][:, 1].astype(int) * SIDE + truth["position"][:, 0]
    kept = np.isin(pixel, data.y.astype(int) * SIDE + data.x)
    np.testing.assert_allclose(data.t, (t[inside & kept] - 5e7) * 1e-9, atol=1e-9)
    seen = len(np.unique(pixel[inside]))
    assert 0.35 < len(np.unique(pixel[inside & kept])) / seen < 0.65
    told = data.calibration.kept
    assert told.sum() == SIDE * SIDE // 2
    assert told[data.y * SIDE + data.x].all()
    content = json.loads((tmp_path / "scene" / "dataset.json").read_text())
    assert content["events"]["kept"] + content["events"]["of_other_pixels"] == inside.sum()
    assert content["views"] == {"val": 1, "test": 1}
    assert data.trajectory.t[-1] == pytest.approx(0.15)


def test_eds(truth, tmp_path):
    assert main(["dataset", "eds", str(write_eds(tmp_path / "08", truth, LENS)), str(tmp_path / "out"), "--quiet"]) == 0
    data = read_dataset(tmp_path / "out")
    same_events(data, truth, tick_ns=1000)
    same_way(data, truth, CLOCK)
    camera = data.calibration.camera
    assert (camera.model, camera.distortion.tolist()) == ("plumb_bob", list(LENS))
    assert data.calibration.circuit.on_threshold / data.calibration.circuit.off_threshold == pytest.approx(114 / 106)
    views = data.views["test"]
    np.testing.assert_allclose(views.exposure / data.views["val"].exposure, 10 ** (6 / 20))
    t = truth["T_wc_timestamp"]
    way = Trajectory((t - t[0]) * 1e-9, truth["T_wc_position"], truth["T_wc_orientation"])
    position, rotation = way.at((truth["frame_t"][1::2] - t[0]) * 1e-9)
    np.testing.assert_allclose(views.position, position + rotation @ BESIDE[:3, 3], atol=1e-4)
    np.testing.assert_allclose(views.rotation, rotation @ BESIDE[:3, :3], atol=1e-4)


@pytest.mark.parametrize("listed", [True, False])
def test_eds_says_where_exposures_are_not_known(truth, tmp_path, listed):
    """They are in times.txt alone; the times of the pictures are in another file, too."""
    folder = write_eds(tmp_path / "08", truth)
    if not listed:
        (folder / "times.txt").unlink()
    assert main(["dataset", "eds", str(folder), str(tmp_path / "out"), "--quiet"]) == 0
    assert len(np.unique(read_dataset(tmp_path / "out").views["test"].exposure)) == 1
    notes = json.loads((tmp_path / "out" / "dataset.json").read_text())["notes"]
    told = "exposures of the views are taken as equal (times.txt: no such file)"
    assert (told in notes) is not listed


def test_tumvie(truth, tmp_path):
    folder = write_tumvie(tmp_path / "raw", truth, compression="gzip", chunks=(512,))
    assert main(["dataset", "tumvie", str(folder), str(tmp_path / "out"), "--quiet"]) == 0
    data = read_dataset(tmp_path / "out")
    same_events(data, truth, tick_ns=1000)
    same_way(data, truth, CLOCK)
    assert data.calibration.camera.model == "equidistant"
    assert data.calibration.circuit.refractory == pytest.approx(1.375e-6)
    t = truth["T_wc_timestamp"]
    way = Trajectory((t - t[0]) * 1e-9, truth["T_wc_position"], truth["T_wc_orientation"])
    position, rotation = way.at((truth["frame_t"][::2] - t[0]) * 1e-9)
    np.testing.assert_allclose(data.views["val"].position, position + rotation @ BESIDE[:3, 3], atol=1e-4)
    notes = json.loads((tmp_path / "out" / "dataset.json").read_text())["notes"]
    assert any("exposures of the views are taken as equal" in note for note in notes)


@pytest.mark.parametrize(
    ("exposures", "told"),
    [
        ([1, 2, 3, 4, 5, 6], []),
        ([1, 2, 3], ["3 of them for 6 pictures"]),
        ([1, 2, 0, 4, 5, 6], ["one is not a positive number"]),
        (None, ["image_exposures_left.txt: no such file"]),
    ],
)
def test_exposures_that_are_not_known_are_told(exposures, told, tmp_path):
    folder = tmp_path / "left_images"
    write_pictures(folder, "{:05d}.jpg", np.zeros((6, 4, 4), np.uint8))
    np.savetxt(folder / "image_timestamps_left.txt", np.arange(6))
    if exposures is not None:
        np.savetxt(folder / "image_exposures_left.txt", exposures)
    pictures = tumvie._pictures(tmp_path, "left", Camera(np.eye(3), 4, 4, np.empty(0)), np.eye(4))
    assert pictures is not None
    np.testing.assert_array_equal(pictures.exposure, np.ones(6) if told else exposures)
    assert len(pictures.notes) == len(told)
    assert all(why in note for why, note in zip(told, pictures.notes, strict=True))


@pytest.mark.parametrize(
    ("file", "rig"),
    [
        ("mocap-desk2-vi_gt_data/mocap-desk2-events_left.h5", "A"),
        ("mocap-desk_and_6dof/mocap-6dof/mocap-6dof-events_left.h5", "B"),
        ("mocap-desk_and_6dof/mocap-6dof/events_left.h5", "B"),
        ("mocap-desk_and_6dof/mocap-6dof/events_left/events_left.h5", "B"),
        ("mocap-desk_and_6dof/mocap-6dof/events_left/0001.h5", "B"),
        ("6dof/skate-easy/events_left/0001.h5", "A"),
        ("6dof/loop-floor0/events_left.h5", "A"),
        ("loop-floor0/../mocap-6dof/events_left.h5", "B"),
    ],
)
def test_the_sequence_says_which_calibration(file, rig, tmp_path):
    """Not a folder further up."""
    assert tumvie._rig(tmp_path / file, "events_left") == rig


def test_blosc_is_read_where_its_filter_is_installed(truth, tmp_path):
    plugin = pytest.importorskip("hdf5plugin")
    folder = write_tumvie(tmp_path / "raw", truth, chunks=(512,), **plugin.Blosc(cname="zstd"))
    assert main(["dataset", "tumvie", str(folder), str(tmp_path / "out"), "--quiet", "--views", "0"]) == 0
    same_events(read_dataset(tmp_path / "out"), truth, tick_ns=1000)


def never_read(begin: int, end: int):
    raise AssertionError("events were read before the views were looked at")


@pytest.mark.parametrize(
    ("wrong", "views", "says"),
    [
        ("nothing", 2, "events were read"),
        ("nothing", 1, "views 1"),
        ("lens", 2, "no pinhole view fits"),
        ("size", 2, "pictures of 5 × 4 pixels, but the calibration says 8 × 8"),
        ("posed", 2, "gone: no such picture"),
    ],
)
def test_views_are_refused_before_events_are_read(wrong, views, says, tmp_path, monkeypatch):
    from pixelid.nerf.data.published import convert
    from pixelid.nerf.data.published.source import Pictures, Poses, Source

    K = np.array([[8.0, 0, 3.5], [0, 8, 3.5], [0, 0, 1]])
    lens = np.array([500.0, 0, 0, 0]) if wrong == "lens" else np.empty(0)
    camera = Camera(K, 8, 8, lens, "plumb_bob")
    t = np.arange(4) * 10**9
    image = np.zeros((4, 5) if wrong == "size" else (8, 8), np.uint8)
    pictures = Pictures(t, tuple("abcd"), np.ones(4), camera, np.eye(4), lambda which: (image for _ in which))
    (tmp_path / "posed").mkdir()
    (tmp_path / "posed" / "transforms_test.json").write_text(json.dumps({"frames": [{"file_path": "gone"}]}))
    poses = Poses(t, np.zeros((4, 3)), np.tile([0.0, 0, 0, 1], (4, 1)))
    source = Source(
        "esim", camera, poses, never_read, pictures, {}, tmp_path / "posed" if wrong == "posed" else None, None, (), ()
    )
    monkeypatch.setitem(convert.LAYOUTS, "esim", lambda path, camera: source)
    (tmp_path / "out").mkdir()
    with pytest.raises(AssertionError if wrong == "nothing" and views == 2 else InputError, match=says):
        convert.convert(tmp_path, "esim", tmp_path / "out", DatasetOptions(views=views))


def test_a_single_picture_is_refused(truth, tmp_path, capsys):
    folder = write_tumvie(tmp_path / "raw", truth, chunks=(512,))
    assert main(["dataset", "tumvie", str(folder), str(tmp_path / "out"), "--quiet", "--views", "1"]) == 2
    assert "--views 1" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_without_views_there_is_a_scene_and_no_score(truth, tmp_path, capsys):
    bag = write_bag(tmp_path / "esim.bag", truth, images=False)
    (tmp_path / "in").mkdir()
    scene = tmp_path / "in" / "scene"
    assert main(["dataset", "esim", str(bag), str(scene), "--quiet"]) == 0
    assert not (scene / "views").exists()
    words = ["reconstruct", str(scene), "--out", str(tmp_path / "out"), "--bandwidth", "off", "--iterations", "20"]
    assert main(words) in (0, 1)
    assert "no views to compare with" in capsys.readouterr().out
    result = json.loads((tmp_path / "out" / "reconstruction.json").read_text())
    assert result["views"] == {"psnr": None, "ssim": None, "lpips": None, "per_view": []}
    assert result["status"] != "diverged"
    assert result["held_out_residual"] > 0
    assert (tmp_path / "out" / "report.html").is_file()
    assert main([*words[:3], str(tmp_path / "two"), *words[4:], "--scale", "level"]) == 2
    assert "--scale level needs views" in capsys.readouterr().err


def test_the_longest_part_without_a_gap_in_the_poses_is_kept(truth, tmp_path, capsys):
    t = truth["T_wc_timestamp"]
    slow = {**truth, "T_wc_timestamp": t * 4, "timestamp": truth["timestamp"] * 4, "frame_t": truth["frame_t"] * 4}
    kept = (t < t[0] + 60_000_000) | (t > t[0] + 90_000_000)
    gone = {**slow, **{name: slow[name][kept] for name in ("T_wc_timestamp", "T_wc_position", "T_wc_orientation")}}
    bag = write_bag(tmp_path / "esim.bag", gone)
    assert main(["dataset", "esim", str(bag), str(tmp_path / "out")]) == 0
    assert "gaps" in capsys.readouterr().out
    content = json.loads((tmp_path / "out" / "dataset.json").read_text())
    assert content["start_s"] == pytest.approx(0.36, abs=0.01)
    assert content["duration_s"] == pytest.approx(0.64, abs=0.01)


@pytest.mark.parametrize(
    ("model", "lens"), [("plumb_bob", (-0.3, 0.1, 2e-3, -1e-3)), ("equidistant", (0.05, -0.01, 2e-3, 0.0))]
)
def test_pictures_lose_the_distortion_of_their_lens(model, lens):
    """The lens' points are those that `Camera.directions` undoes, and a picture of a plane becomes the pinhole's."""
    K = np.array([[60.0, 0, 39.5], [0, 60, 29.5], [0, 0, 1]])
    camera = Camera(K, 80, 60, np.array(lens), model)
    flat = np.random.default_rng(0).uniform(-0.5, 0.5, (50, 2))
    xy = camera.distorted(flat) @ K[:2, :2].T + K[:2, 2]
    rays = camera.directions(xy)
    np.testing.assert_allclose(rays[:, :2] / rays[:, 2:], flat, atol=1e-6)

    def plane(rays):  # smooth, so that interpolation is not what is tested
        return 0.5 + 0.3 * np.sin(5 * rays[:, 0] / rays[:, 2]) * np.cos(4 * rays[:, 1] / rays[:, 2])

    pinhole = pinhole_of(camera)
    image = plane(camera.all_directions()).reshape(60, 80).astype(np.float32)
    np.testing.assert_allclose(
        undistorted(image, camera, pinhole), plane(pinhole.all_directions()).reshape(60, 80), atol=4e-3
    )


@pytest.mark.parametrize("row", [1, 3, 4, 8, 9])
def test_times_out_of_order_are_found_in_every_block_and_between_blocks(row, tmp_path, monkeypatch):
    from pixelid.nerf.data.published import hdf5_events

    monkeypatch.setattr(hdf5_events, "BLOCK", 4)
    t = np.repeat(np.arange(5, dtype=np.uint64), 2) + 10**6  # equal times are in order
    with h5py.File(tmp_path / "events.h5", "w") as file:
        file.update({f"events/{name}": np.zeros(10, np.uint16) for name in "xyp"})
        file["events/t"] = t
    (looked,) = hdf5_events.event_blocks(tmp_path / "events.h5", 0, -1)
    assert looked["events"] == [10]
    assert len(list(hdf5_events.event_blocks(tmp_path / "events.h5", 0, 10**12))) == 4
    t[row] = 7
    with h5py.File(tmp_path / "events.h5", "r+") as file:
        del file["events/t"]
        file["events/t"] = t
    with pytest.raises(InputError, match=rf"events\.h5: events/t: row {row} is earlier than the one before; sort"):
        list(hdf5_events.event_blocks(tmp_path / "events.h5", 0, 10**12))


@pytest.mark.parametrize(("row", "stamp", "refused"), [
    (31, 5, False), (31, 10**6, False), (47, 5, False), (170, 5, False), (190, 10**6, False),
    (80, 5, True), (80, 10**6, True), (120, 40, True), (120, 10**6, True),
])  # fmt: skip
def test_an_event_out_of_order_outside_the_time_asked_for_is_no_matter(row, stamp, refused, tmp_path, monkeypatch):
    """Rows 60 … 140 of 200 are asked for; wherever bisection looks, it finds them."""
    from pixelid.nerf.data.published import hdf5_events

    monkeypatch.setattr(hdf5_events, "BLOCK", 16)
    monkeypatch.setattr(hdf5_events, "PROBE", 8)
    t = np.arange(200, dtype=np.uint64) + 1000
    t[row] = stamp
    with h5py.File(tmp_path / "events.h5", "w") as file:
        file.update({f"events/{name}": np.arange(200, dtype=np.uint16) for name in "xyp"})
        file["events/t"] = t
    blocks = hdf5_events.event_blocks(tmp_path / "events.h5", 1_060_000, 1_140_000)
    if refused:
        with pytest.raises(InputError, match="is earlier than the one before"):
            list(blocks)
        return
    next(blocks)
    read = list(blocks)
    x, time = (np.concatenate([block[name] for block in read]) for name in ("x", "t"))
    assert x[(time >= 1_060_000) & (time <= 1_140_000)].tolist() == list(range(60, 141))
    assert len(x) < 120


def peak_bytes_of_events(folder: Path, copies: int, truth, monkeypatch) -> int:
    """Most memory that Python holds while so many copies of the events go through, after their first block."""
    import tracemalloc

    from pixelid.nerf.data.published import hdf5_events
    from pixelid.nerf.data.published.convert import convert

    monkeypatch.setattr(hdf5_events, "BLOCK", 4096)
    order = np.repeat(np.arange(len(truth["timestamp"])), copies)
    many = {**truth, **{name: truth[name][order] for name in ("timestamp", "position", "polarity")}}
    write_eds(folder, many)
    (folder / "out").mkdir()
    held: list[int] = []

    def progress(what: str, share: float) -> None:
        if what == "events" and not held:
            tracemalloc.reset_peak()
            held.append(tracemalloc.get_traced_memory()[0])
        elif what == "events" and share == 1.0:
            held.append(tracemalloc.get_traced_memory()[1])

    tracemalloc.start()
    kept = convert(folder, "eds", folder / "out", DatasetOptions(views=0), progress).content["events"]["kept"]
    tracemalloc.stop()
    assert kept == len(order)
    return held[-1] - held[0]


def test_memory_does_not_grow_with_the_sequence(truth, tmp_path, monkeypatch):
    small = peak_bytes_of_events(tmp_path / "small", 20, truth, monkeypatch)
    large = peak_bytes_of_events(tmp_path / "large", 200, truth, monkeypatch)
    more = 13 * 180 * len(truth["timestamp"])  # bytes of the events that are more
    assert large - small < more / 4


def test_an_event_takes_at_most_sixty_bytes_in_training(made):
    from pixelid.nerf.training.problem import problem_of

    data = read_dataset(made)
    problem = problem_of(data)
    kept = [data.t, data.x, data.y, data.on, problem.training.starts, problem.held_out.starts]
    kept += list(problem.training.stretches)
    assert problem.training.stretches is problem.held_out.stretches
    assert sum(column.nbytes for column in kept) <= 60 * len(data.t)
    assert data.views["test"].images.dtype == np.float32


def without(name: str):
    def remove(folder: Path) -> None:
        next(folder.glob(f"**/{name}")).unlink()

    return remove


def rewritten(name: str, old: str, new: str):
    def write(folder: Path) -> None:
        file = next(folder.glob(f"**/{name}"))
        text = file.read_text()
        assert old in text
        file.write_text(text.replace(old, new))

    return write


def cut(name: str):
    def write(folder: Path) -> None:
        file = next(folder.glob(f"**/{name}"))
        file.write_bytes(file.read_bytes()[: file.stat().st_size // 3])

    return write


def with_column(name: str, change):
    def write(folder: Path) -> None:
        with h5py.File(next(folder.glob("*.h5")), "r+") as file:
            values = change(file[f"events/{name}"][()])
            del file[f"events/{name}"]
            if values is not None:
                file[f"events/{name}"] = values

    return write


WRONG = {
    "no events": ("eds", without("events.h5"), "events.h5"),
    "no poses": ("eds", without("stamped_groundtruth.txt"), "stamped_groundtruth.txt"),
    "no calibration": ("eds", without("*.yaml"), "camchain*.yaml"),
    "no YAML": ("eds", rewritten("*.yaml", "cam0:", "cam0: ["), "not valid YAML"),
    "unknown lens": ("eds", rewritten("*.yaml", "radtan", "fov"), "fov"),
    "a lens that turns back": (
        "eds",
        rewritten("*.yaml", str(list(LENS)), "[-2.0, 0.0, 0.0, 0.0]"),
        "cannot be undone",
    ),
    "no way between cameras": ("eds", rewritten("*.yaml", "T_cn_cnm1", "T_cam_imu"), "T_cn_cnm1"),
    "poses of words": ("eds", rewritten("stamped_groundtruth.txt", "1600000000.1", "x"), "expected lines of numbers"),
    "fewer times": ("eds", rewritten("times.txt", "frame_0000000003.png", ""), "times.txt"),
    "missing picture": ("eds", without("frame_0000000002.png"), "frame_0000000002.png"),
    "truncated events": ("eds", cut("events.h5"), "events.h5"),
    "no polarity": ("eds", with_column("p", lambda p: None), "events/p: missing"),
    "fewer x": ("eds", with_column("x", lambda x: x[:-4]), "one length"),
    "outside the sensor": ("eds", with_column("x", lambda x: x + 9), "events/x: expected 0 … 15"),
    "left of the sensor": (
        "eds",
        with_column("x", lambda x: x.astype(int) - 99),
        "0 … 15 as the calibration says, found -",
    ),
    "times as numbers with fractions": ("eds", with_column("t", lambda t: t * 1.0), "whole microseconds"),
    "events out of order": ("eds", with_column("t", lambda t: np.roll(t, 1)), "events/t: row 1 is earlier"),
    "events of another day": ("eds", with_column("t", lambda t: t + 10**11), "--time-offset"),
    "no mocap": ("tumvie", without("mocap_data.txt"), "mocap_data.txt"),
    "no marker": ("tumvie", without("mocap-imu-calibrationA.json"), "mocap-imu-calibration"),
    "other cameras": ("tumvie", rewritten("camera-calibrationA.json", "kb4", "ds"), "kb4"),
    "no JSON": ("tumvie", cut("camera-calibrationA.json"), "not valid JSON"),
    "fewer pictures": ("tumvie", without("00003.jpg"), "image_timestamps_left.txt"),
}


@pytest.mark.parametrize("wrong", WRONG)
def test_a_broken_sequence_is_refused(wrong, truth, tmp_path, capsys):
    layout, change, says = WRONG[wrong]
    folder = write_eds(tmp_path / "raw", truth, LENS) if layout == "eds" else write_tumvie(tmp_path / "raw", truth)
    change(folder)
    refused(["dataset", layout, str(folder), str(tmp_path / "out")], says, tmp_path / "out", capsys)


def test_events_beside_the_poses_are_told_on_the_clock_of_the_poses(truth, tmp_path, capsys):
    """--time-offset included: found and expected can be compared."""
    bag, late = write_bag(tmp_path / "esim.bag", truth), truth["timestamp"][[0, -1]] + EPOCH_NS + 400_000_000
    words = ["dataset", "esim", str(bag), str(tmp_path / "out"), "--time-offset", "0.4"]
    refused(words, f"found {late[0]} … {late[1]} ns", tmp_path / "out", capsys)


def test_pixels_that_are_kept_and_never_fire_are_told(truth, tmp_path, capsys):
    pixel = truth["position"][:, 1].astype(int) * SIDE + truth["position"][:, 0]
    mine = pixel == pixel[0]
    one = {**truth, **{name: truth[name][mine] for name in ("timestamp", "position", "polarity")}}
    bag = write_bag(tmp_path / "esim.bag", one)
    words = ["dataset", "esim", str(bag), str(tmp_path / "out"), "--every", "256"]
    refused(words, f"--every: none of the {mine.sum()} events is of a pixel that is kept", tmp_path / "out", capsys)


def refused(words, says, out: Path, capsys) -> None:
    assert main(words) == 2
    printed = capsys.readouterr().err
    assert 1 <= len(printed.splitlines()) <= 2, printed
    assert says in printed
    assert not out.exists()
    assert not [path for path in out.parent.iterdir() if path.name.startswith(f".{out.name}")]


def test_one_sequence_of_several_has_to_be_named(truth, tmp_path, capsys):
    folder = write_tumvie(tmp_path / "raw", truth)
    shutil.copy(folder / "mocap-desk2-events_left.h5", folder / "skate-easy-events_left.h5")
    refused(["dataset", "tumvie", str(folder), str(tmp_path / "out")], "one sequence", tmp_path / "out", capsys)
    one = folder / "mocap-desk2-vi_gt_data"  # everything else lies beside it, under its name
    assert main(["dataset", "tumvie", str(one), str(tmp_path / "out"), "--quiet", "--views", "0"]) == 0


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"pose": False}, "/cam0/pose"),
        ({"lens": (0.1, 0.1), "model": "fov"}, "fov"),
        ({"lens": (0.1,) * 8, "model": "rational_polynomial"}, "rational_polynomial"),
    ],
)
def test_a_bag_that_lacks_something_is_refused(options, says, truth, tmp_path, capsys):
    bag = write_bag(tmp_path / "esim.bag", truth, **options)
    refused(["dataset", "esim", str(bag), str(tmp_path / "out")], says, tmp_path / "out", capsys)


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["esim", "nothing.bag"], "no such file"),
        (["kitti", "{bag}"], "esim"),
        (["esim", "{bag}", "--start", "9"], "--start, --end"),
        (["esim", "{bag}", "--start", "0.2", "--end", "0.1"], "--end"),
        (["esim", "{bag}", "--every", "0"], "--every"),
        (["esim", "{bag}", "--camera", "cam7"], "/cam7/events"),
        (["esim", "{cut}"], "ROS bag"),
        (["eds", "{bag}"], "expected the folder"),
        (["tumvie", "{bag}", "--camera", "top"], "left or right"),
    ],
)
def test_wrong_usage_is_refused(words, says, truth, tmp_path, capsys):
    bag = write_bag(tmp_path / "esim.bag", truth, images=False)
    (tmp_path / "cut.bag").write_bytes(bag.read_bytes()[:5000])
    names = {"bag": str(bag), "cut": str(tmp_path / "cut.bag")}
    filled = [word.format(**names) for word in words]
    refused(["dataset", *filled[:2], str(tmp_path / "out"), *filled[2:]], says, tmp_path / "out", capsys)
