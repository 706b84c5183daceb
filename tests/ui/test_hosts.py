"""Where a page listens, by which names it may be asked, and what is printed of it."""

import socket

import pytest

from hil.commands.common import tell_page
from hil.commands.ui import desk_application
from hil.errors import ConfigError
from hil.ui.desk import Desk
from hil.web.site import Hosts, serve_until_interrupt

TestClient = pytest.importorskip("starlette.testclient").TestClient
HEAD = {"X-Hil-Token": "secret"}


def asked(host, name):
    """Status of a question with the right token that reaches the page by a name."""
    desk = Desk([], lambda: None)
    client = TestClient(desk_application(desk, "secret", "teleop", hosts=Hosts(host)))
    return client.get("/api/view?page=page-one-1", headers={**HEAD, "Host": name}).status_code


@pytest.mark.parametrize("name", ["127.0.0.1:8080", "localhost:1", "[::1]:8080", "LOCALHOST"])
def test_a_page_of_this_machine_is_asked_by_its_names(name):
    assert asked("127.0.0.1", name) == 200


@pytest.mark.parametrize(
    "name",
    ["evil.example", "127.0.0.1.evil.example", "192.168.0.7:80", "testserver", "", "[", "a@b:x"],
)
def test_and_by_no_other(name):
    assert asked("127.0.0.1", name) == 400


def test_a_page_on_one_address_is_asked_by_that_one():
    assert asked("192.168.0.7", "192.168.0.7:8080") == 200
    assert asked("lab-pc", "LAB-PC:8080") == 200
    assert asked("192.168.0.7", "192.168.0.8:8080") == 400


@pytest.mark.parametrize("host", ["0.0.0.0", "::"])
def test_a_page_on_all_addresses_is_asked_by_numbers_and_by_the_name_of_this_machine(host):
    for name in ("192.168.0.7:8080", "[fe80::1]:8080", f"{socket.gethostname()}:8080"):
        assert asked(host, name) == 200
    # the name of a site elsewhere that stands for an address of this machine
    for name in ("evil.example", "192.168.0.7.evil.example"):
        assert asked(host, name) == 400


@pytest.mark.parametrize("given", [{}, {"X-Hil-Token": ""}, {"X-Hil-Token": "secre"}])
def test_on_every_address_a_request_needs_the_token(given):
    desk = Desk([], lambda: None)
    client = TestClient(desk_application(desk, "secret", "teleop", hosts=Hosts("0.0.0.0")))
    head = {"Host": "192.168.0.7", **given}
    assert client.get("/", headers=head).status_code == 403
    assert client.get("/?token=guess", headers=head).status_code == 403
    for name in ("take", "begin", "command"):
        assert client.post(f"/api/{name}", json={}, headers=head).status_code == 403
    assert client.get("/api/view?page=page-one-1", headers=head).status_code == 403


@pytest.mark.parametrize(
    ("host", "port", "said"),
    [
        ("192.0.2.7", 0, "no address of this machine"),
        ("127.0.0.1", 70_000, "65535"),
        ("no such name", 0, "no such address"),
    ],
)
def test_where_a_page_cannot_listen_is_said(host, port, said):
    with pytest.raises(ConfigError, match=said):
        serve_until_interrupt(None, host, port, lambda here, there: None, "secret")


def test_the_address_for_others_comes_with_what_it_lets_them_do(capsys):
    tell_page("The page", "http://127.0.0.1:1/?token=x", "", "can move the arms", False)
    assert capsys.readouterr().out == "The page is open at http://127.0.0.1:1/?token=x\n"
    here, there = "http://127.0.0.1:1/?token=x", "http://192.168.0.7:1/?token=x"
    tell_page("The page", here, there, "can move the arms", False)
    told = " ".join(capsys.readouterr().out.split())
    assert there in told and "warning: Anyone who has this address can move the arms" in told
