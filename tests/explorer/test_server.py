"""The explorer's server answers its own page, and nobody else."""

import socket
import threading
from concurrent.futures import ThreadPoolExecutor

import pytest

from beamfield.explorer.requests import LARGEST_MESSAGE
from beamfield.explorer.server import HEADERS, explorer_app, listening_socket, new_token, page_address

testclient = pytest.importorskip("starlette.testclient")

PORT = 8123
TOKEN = new_token()
ORIGIN = f"http://127.0.0.1:{PORT}"
OWN = {"X-Beamfield-Token": TOKEN, "Content-Type": "application/json"}


@pytest.fixture(scope="module")
def client(session):
    return testclient.TestClient(explorer_app(session, TOKEN, PORT), base_url=ORIGIN, raise_server_exceptions=False)


def test_the_page_needs_the_token(client):
    assert client.get(f"/?token={TOKEN}").text.startswith("<!doctype html>")
    for query in ("", "?token=", "?token=wrong", f"?token={TOKEN}x", "?token=%00%ff"):
        answer = client.get(f"/{query}")
        assert answer.status_code == 403
        assert "html" not in answer.text


def test_every_answer_has_the_policy(client):
    for path in (f"/?token={TOKEN}", "/", "/explorer.js", "/explorer.css", "/nothing"):
        answer = client.get(path)
        assert {name: answer.headers[name] for name in HEADERS} == HEADERS
    policy = dict(part.split(maxsplit=1) for part in HEADERS["Content-Security-Policy"].split("; "))
    assert {policy[name] for name in ("default-src", "base-uri", "form-action", "frame-ancestors")} == {"'none'"}
    assert {policy[name] for name in ("script-src", "style-src", "connect-src")} == {"'self'"}
    assert "unsafe" not in HEADERS["Content-Security-Policy"]
    assert "http" not in HEADERS["Content-Security-Policy"]


def test_it_answers_its_page(client):
    answer = client.post("/ask", json={"name": "start"}, headers={**OWN, "Origin": ORIGIN})
    assert answer.status_code == 200
    assert len(answer.json()["times"]) == 12


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({"X-Beamfield-Token": ""}, 403),
        ({"X-Beamfield-Token": "wrong"}, 403),
        ({"Origin": "https://example.org"}, 403),
        ({"Origin": "null"}, 403),
        ({"Origin": f"http://127.0.0.1:{PORT + 1}"}, 403),
        ({"Host": "example.org"}, 403),
        ({"Host": f"example.org:{PORT}"}, 403),
        ({"Content-Type": "text/plain"}, 415),
        ({"Content-Type": "application/x-www-form-urlencoded"}, 415),
    ],
)
def test_others_are_refused(client, headers, status):
    answer = client.post("/ask", content=b'{"name": "start"}', headers={**OWN, **headers})
    assert answer.status_code == status
    assert "times" not in answer.text


@pytest.mark.parametrize("path", ["/", "/explorer.js"])
def test_pages_are_not_given_to_other_hosts(client, path):
    assert client.get(path, params={"token": TOKEN}, headers={"Host": "rebound.example.org"}).status_code == 403


@pytest.mark.parametrize(
    ("body", "status", "words"),
    [
        (b"", 400, "JSON"),
        (b"{", 400, "JSON"),
        (b"\xff\xfe", 400, "JSON"),
        (b"[" * 15_000, 400, ""),
        (b'{"name": "start"}' + b" " * LARGEST_MESSAGE, 413, "at most"),
        (b"null", 400, "object"),
        (b'{"name": "scan", "i": NaN}', 400, "i:"),
        (b'{"name": "scan", "i": 1e999, "set": 0, "pose": [0, 0, 0]}', 400, "i:"),
        (b'{"name": "file", "set": 0, "i": 0, "pose": [0,0,0], "parameters": {"0": {"../../etc": 1}}}', 400, "names"),
    ],
)
def test_malformed_messages_are_refused(client, body, status, words):
    answer = client.post("/ask", content=body, headers=OWN)
    assert answer.status_code == status
    assert words in answer.json()["error"]


@pytest.mark.parametrize(
    "path",
    ["/../server.py", "/%2e%2e/server.py", "/..%2fserver.py", "/%2fetc%2fpasswd", "//etc/passwd", "/page/index.html",
     "/server.py", "/explorer.js/", "/.", "/%00"],
)  # fmt: skip
def test_no_other_file_is_given(client, path):
    answer = client.get(path, params={"token": TOKEN})
    assert answer.status_code in (403, 404) or answer.text.startswith("<!doctype html>")
    assert "import" not in answer.text
    assert "root:" not in answer.text


def test_scores_do_not_wait_for_a_heat_map():
    begun, scored = threading.Event(), threading.Event()

    class Slow:
        def answer(self, message):
            if message["name"] == "scan":
                scored.set()
                return {}
            begun.set()
            return {"scored": scored.wait(5.0)}

    client = testclient.TestClient(explorer_app(Slow(), TOKEN, PORT), base_url=ORIGIN)
    with ThreadPoolExecutor() as pool, client:
        heat = pool.submit(client.post, "/ask", json={"name": "heat"}, headers=OWN)
        assert begun.wait(5.0)
        client.post("/ask", json={"name": "scan"}, headers=OWN)
        assert heat.result().json() == {"scored": True}


def test_only_the_loopback_address_is_served():
    with listening_socket(0) as listening:
        host, port = listening.getsockname()
        assert host == "127.0.0.1"
        assert listening.proto == socket.IPPROTO_TCP  # or asyncio lets small answers wait for more to send
        assert page_address(port, "t") == f"http://127.0.0.1:{port}/?token=t"
        with pytest.raises(OSError, match="in use"):
            listening_socket(port)
    assert new_token() != new_token()
