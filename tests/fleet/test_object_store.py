"""A fleet in an object store: S3's protocol, spoken with a real server of this machine."""

from __future__ import annotations

import json
import logging
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("s3fs")
pytest.importorskip("moto.server")

import boto3
import s3fs
from moto.server import ThreadedMotoServer

from beamfield.cli.main import main
from beamfield.errors import FormatError, InvalidInputError
from beamfield.fleet.catalogue import open_catalogue
from beamfield.fleet.folder import Folder
from beamfield.fleet.scan import FleetScan

KEY, SECRET, PASSWORD = "AKIAEXAMPLE", "wJalrSECRETexample", "hunter2-password"


@pytest.fixture(scope="module")
def endpoint() -> Iterator[str]:
    logging.getLogger("werkzeug").setLevel(logging.ERROR)
    server = ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    server.start()
    host, port = server.get_host_and_port()
    yield f"http://{host}:{port}"
    server.stop()


@pytest.fixture
def bucket(endpoint: str, monkeypatch) -> Iterator[str]:
    """The name of an empty bucket; its keys are where AWS's programs look for them."""
    for name, value in (("AWS_ACCESS_KEY_ID", KEY), ("AWS_SECRET_ACCESS_KEY", SECRET), ("AWS_ENDPOINT_URL", endpoint),
                        ("AWS_DEFAULT_REGION", "us-east-1")):  # fmt: skip
        monkeypatch.setenv(name, value)
    s3fs.S3FileSystem.clear_instance_cache()
    boto3.client("s3").create_bucket(Bucket="fleet")
    yield "fleet"
    store = boto3.resource("s3").Bucket("fleet")
    store.objects.all().delete()
    store.delete()


def test_logs_in_a_store_are_scanned_into_a_store_and_no_secret_is_told(
    bucket: str, endpoint: str, scanned: FleetScan, world: Path, capsys
):
    store = s3fs.S3FileSystem()
    for name in ("run0.log", "office.yaml", "office.pgm"):
        store.put_file(str(world / name), f"{bucket}/raw/{name}")
    store.pipe_file(
        f"{bucket}/raw/fleet.csv",
        (
            "log,map,robot,site\n"
            "run0.log,office.yaml,ann,hall\n"
            f"{world / 'run3.log'},{world / 'office.yaml'},bob,hall\n"
            f"s3://{KEY}:{PASSWORD}@{bucket}/raw/a.log?token={SECRET},{world / 'office.yaml'},cid,hall\n"
            f"s3://{bucket}/raw/none.log,{world / 'office.yaml'},cid,hall\n"
        ).encode(),
    )
    manifest = f"s3://{bucket}/raw/fleet.csv"
    words = ["fleet", "scan", manifest, "--out", f"s3://{bucket}/catalogue", "--scheduler", "serial", "--json"]
    assert main(words) == 0
    told = capsys.readouterr()
    document = json.loads(told.out)
    assert [run["status"] for run in document["runs"]] == ["used"] * 2 + ["left out"] * 2
    assert document["runs"][3]["reason"] == f"s3://{bucket}/raw/none.log: No such file or directory"
    options = {"key": KEY, "secret": SECRET, "client_kwargs": {"endpoint_url": endpoint}}
    catalogue = open_catalogue(f"s3://{bucket}/catalogue", options)
    for ours, i in zip(catalogue.shards(), (0, 3), strict=True):
        theirs = next(one for one in scanned.catalogue.shards() if one.run == scanned.records[i].run)
        assert ours.address == f"s3://{bucket}/catalogue/{ours.path}"
        np.testing.assert_array_equal(ours.read(["range"])["range"], theirs.read(["range"])["range"])
    assert catalogue.dataset().count_rows() == sum(shard.rows for shard in catalogue.shards())
    assert catalogue.grid(catalogue.used[0]).shape == scanned.catalogue.grid(scanned.records[0]).shape
    # Scanned again, only what could not be read is.
    assert main(words) == 0
    assert json.loads(capsys.readouterr().out)["scanned"] == [run["run"] for run in document["runs"][2:]]
    everything = [told.out, told.err, repr(catalogue), repr(catalogue.shards()), repr(catalogue.runs)]
    everything += [store.cat(path).decode("latin-1") for path in store.find(f"{bucket}/catalogue")]
    for secret in (SECRET, PASSWORD, KEY):
        assert not any(secret in one for one in everything)


def test_what_a_store_refuses_is_said_without_secrets(bucket: str, endpoint: str):
    options = {"key": KEY, "secret": SECRET, "client_kwargs": {"endpoint_url": endpoint}}
    with pytest.raises(FormatError, match=r"s3://fleet/none: no catalogue of a fleet"):
        open_catalogue(f"s3://{bucket}/none", options)
    with pytest.raises(OSError, match="bucket") as refused:
        Folder("s3://no-such-bucket/catalogue", options).write("catalogue.json", b"{}")
    assert SECRET not in str(refused.value)
    unreachable = {**options, "client_kwargs": {"endpoint_url": f"http://{SECRET}.invalid:1"}, "config_kwargs":
                   {"retries": {"max_attempts": 0}}}  # fmt: skip
    with pytest.raises(OSError, match=r"s3://fleet/catalogue\.json") as down:
        Folder(f"s3://{bucket}", unreachable).read("catalogue.json")
    assert SECRET not in str(down.value)
    with pytest.raises(InvalidInputError, match=r"nowhere://host/x: this address cannot be opened") as unknown:
        Folder(f"nowhere://ann:{PASSWORD}@host/x?key={SECRET}").read("a")
    assert not {PASSWORD, SECRET} & set(str(unknown.value).split())
    assert PASSWORD not in str(unknown.value)


def write_half(folder: Folder, name: str) -> None:
    with folder.writing(name) as part:
        part.write_bytes(b"half")
        raise KeyboardInterrupt


def test_an_upload_that_is_interrupted_leaves_nothing(bucket: str):
    folder = Folder(f"s3://{bucket}/catalogue")
    with pytest.raises(KeyboardInterrupt):
        write_half(folder, "beams/a.parquet")
    assert not folder.exists("beams/a.parquet")
    folder.write("beams/a.parquet", b"whole")
    assert folder.read_all(["beams/a.parquet", "beams/none"]) == [b"whole", None]
    folder.remove("beams/a.parquet")
    folder.remove("beams/a.parquet")
    assert folder.names("beams") == []


def test_a_store_that_is_none_of_objects_gets_files_by_rename(tmp_path: Path):
    folder = Folder(f"file://{tmp_path}/catalogue")
    folder.write("runs/a.json", b"{}")
    assert (folder.names("runs"), folder.read("runs/a.json")) == (["a.json"], b"{}")
