"""Sound files of every kind that is read, made as they are needed."""

from __future__ import annotations

import gzip
import io
import json
from pathlib import Path

import numpy as np
import pandas as pd


def run(rows: int = 300) -> pd.DataFrame:
    """A log that can be read."""
    t = 1e-2 * np.arange(rows)
    wave = np.sin(9 * t)
    return pd.DataFrame({
        "time [s]": t, "u [V]": 2 * np.cos(20 * t), "x [mm]": 9 * wave,
        "P_a1 [bar]": 70 + 5 * wave, "P_a2 [bar]": 70 - 5 * wave, "F [kN]": 0.5 * wave,
    })  # fmt: skip


def samples(folder: Path) -> None:
    """Write them into a folder."""
    import h5py
    import scipy.io

    from hydrojax.paper.records import reference
    from hydrojax.tune.chunks import Chunks
    from hydrojax.workflows.fleet.store import Store

    frame = run()
    frame.to_csv(folder / "log.csv", index=False, float_format="%.6g")
    text = (folder / "log.csv").read_bytes()
    (folder / "log.csv.gz").write_bytes(gzip.compress(text, mtime=0))
    frame.to_parquet(folder / "log.parquet")
    plain = {name.split(" ")[0]: frame[name].to_numpy() for name in frame}
    units = {name.split(" ")[0]: name.split("[")[1][:-1] for name in frame}
    for name, zipped in (("log.mat", False), ("zipped.mat", True)):
        tree = {"log": plain, "units": units}
        scipy.io.savemat(folder / name, tree, do_compression=zipped)
    with h5py.File(folder / "log73.mat", "w") as file:
        for name, values in plain.items():
            file[name] = values
            file[f"{name}_unit"] = np.array([ord(c) for c in units[name]], np.uint16)
            file[f"{name}_unit"].attrs["MATLAB_class"] = np.bytes_("char")
    _excel(folder / "log.xlsx", frame)
    _bag(folder / "log.mcap", frame)
    if not (folder / "bag").exists():
        write_bag_folder(folder / "bag")
    (folder / "rig.toml").write_text(reference()[0].text)
    report = {
        "format": "hydrojax-report/1", "rig": "bench", "verdict": "explained",
        "logs": {"fit": ["a.csv"], "validate": [], "test": []}, "sentence": "",
        "parameters": {"beta": {"value": 8e8, "std": 8e6, "unit": "Pa"}},
        "channels": {"F": {"unit": "N", "after": 1.0}}, "candidates": [],
        "effects": [{"name": "stribeck", "parameters": {}}],
        "covariance": {"names": ["beta"], "matrix": [[6.4e13]]},
    }  # fmt: skip
    (folder / "report.json").write_text(json.dumps(report))
    rows = "job,rig,fit,validate,oil\na,rig.toml,a.csv;b.csv,c.csv,40\n"
    (folder / "jobs.csv").write_text(rows)
    Store(folder / "fleet").save("ab12", {"failed": "", "seconds": {"all": 1.0}}, True)
    chunks = Chunks(folder / "sweep", "question", "key")
    chunks.claim()
    chunks.write("linear-4", 0, {"peak": np.arange(4.0)})


def _excel(path: Path, frame: pd.DataFrame) -> None:
    try:
        frame.to_excel(path, index=False)
    except ImportError:
        return


def _bag(path: Path, frame: pd.DataFrame) -> None:
    try:
        from mcap.writer import Writer
    except ImportError:
        return
    store = io.BytesIO()
    writer = Writer(store)
    writer.start()
    schema = writer.register_schema("a/msg/B", "ros2msg", b"float64 u\nfloat64 x\n")
    channel = writer.register_channel("/rig", "cdr", schema)
    for i, row in enumerate(frame.to_numpy()):
        data = b"\0\1\0\0" + np.array([row[1], row[2]]).tobytes()
        writer.add_message(channel, i * 10**7, data, i * 10**7)
    writer.finish()
    path.write_bytes(store.getvalue())


def write_bag_folder(folder: Path) -> None:
    """A ROS 2 bag of one topic with a number, if the library is there."""
    try:
        from rosbags.rosbag2 import StoragePlugin, Writer
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        return
    store = get_typestore(Stores.ROS2_HUMBLE)
    kind = "std_msgs/msg/Float64"
    with Writer(folder, version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        link = writer.add_connection("/rig", kind, typestore=store)
        for i, x in enumerate(run()["x [mm]"]):
            data = store.serialize_cdr(store.types[kind](data=x), kind)
            writer.write(link, i * 10**7, data)
    found = next(folder.glob("*.db3"))
    meta = folder / "metadata.yaml"
    meta.write_text(meta.read_text().replace(found.name, "bag.db3"))
    found.rename(folder / "bag.db3")
