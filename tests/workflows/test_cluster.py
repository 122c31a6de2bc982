"""A cluster on this machine: nobody but its owner may have code run."""

from __future__ import annotations

import socket
import urllib.error
import urllib.request

import psutil
import pytest

from hydrojax.errors import InputError
from hydrojax.workflows.fleet.cluster import client

pytest.importorskip("distributed")
pytest.importorskip("cryptography")


def listening() -> set[tuple[str, int]]:
    """Addresses at which this process and its children listen."""
    me = psutil.Process()
    every = (
        c
        for process in (me, *me.children(recursive=True))
        for c in process.net_connections(kind="inet")
    )
    return {(c.laddr.ip, c.laddr.port) for c in every if c.status == "LISTEN"}


PAGES = ("health", "metrics", "info/main/workers.html", "json/counts.json", "status",
         "statics/js/reconnecting-websocket.min.js")  # fmt: skip


def answer(ip: str, port: int, page: str) -> str:
    """What a port says to a stranger who asks for a page of dask's."""
    try:
        with urllib.request.urlopen(f"http://{ip}:{port}/{page}", timeout=2) as got:
            return f"page {got.status}"
    except urllib.error.HTTPError as error:
        return f"error {error.code}"
    except (OSError, ValueError):
        return "nothing"


def test_a_local_cluster_wants_its_own_key_and_serves_no_page():
    before = listening()
    with client("local:1") as found:
        assert found.submit(max, 2, 3).result() == 3
        assert found.scheduler.address.startswith("tls://127.0.0.1:")
        opened = listening() - before
        assert opened and all(ip == "127.0.0.1" for ip, _ in opened)
        assert not [p for ip, p in opened if p == 8787]
        said = {answer(*address, page) for address in opened for page in PAGES}
        assert said <= {"nothing", "error 404"}
        port = int(found.scheduler.address.rpartition(":")[2])
        with socket.create_connection(("127.0.0.1", port)) as stranger:
            stranger.settimeout(5)
            stranger.sendall(b"\0" * 64)  # as the unencrypted protocol begins
            try:
                heard = stranger.recv(64)
            except OSError:
                heard = b""
        assert heard == b"" or heard[0] == 21  # a TLS alert


@pytest.mark.parametrize("count", ["0", "", "²", "100000000", "9" * 5000, "-1"])
def test_a_number_of_workers_that_cannot_be(count):
    with pytest.raises(InputError, match="write local:N"), client(f"local:{count}"):
        raise AssertionError("it began")
