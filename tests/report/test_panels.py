"""Figures as plain data: the layout that plotly's own classes would make."""

import base64
import html
import json
import re

import numpy as np
import pytest

from hil.models import catalogue
from hil.report.elements import Panels, nested, typeset


def drawn(page: str) -> list:
    return json.loads(re.search(r'class="figure">(.*)</script>', page).group(1))


def figure() -> Panels:
    fig = Panels([100.0, 300.0], 2, 100.0, 0.1, ["a", "b", "", "d"])
    fig.update_layout(width=400, height=500.0, margin_t=7)
    return fig


def test_names_with_underscores_are_parts():
    more = nested({"title_font_size": 3, "paper_bgcolor": "w", "marker": {"line_width": 0}})
    expected = {"title": {"font": {"size": 3}}, "paper_bgcolor": "w"}
    assert more == {**expected, "marker": {"line": {"width": 0}}}


def test_panels_stand_where_they_should():
    layout = figure().layout
    assert layout["yaxis"]["domain"] == [0.8, 1.0] and layout["xaxis2"]["anchor"] == "y2"
    np.testing.assert_allclose(layout["yaxis4"]["domain"], [0.0, 0.6], atol=1e-12)
    np.testing.assert_allclose(layout["xaxis4"]["domain"], [0.55, 1.0], atol=1e-12)
    assert [a["text"] for a in layout["annotations"]] == ["a", "b", "d"]
    assert layout["margin"] == {"t": 7}


def test_one_axis_a_row_or_all_are_changed():
    fig = figure()
    fig.update_xaxes(title_text="t", row=2)
    fig.update_yaxes(nticks=4, row=1, col=2)
    fig.update_yaxes(title_text="u", col=1)
    assert [("title" in fig.layout[f"xaxis{k}"]) for k in ("", 2, 3, 4)] == [False] * 2 + [True] * 2
    assert "nticks" in fig.layout["yaxis2"] and "nticks" not in fig.layout["yaxis"]
    assert fig.layout["yaxis3"]["title"] == {"text": "u"} and "title" not in fig.layout["yaxis4"]


def test_written_as_plotly_reads_it():
    fig = figure()
    x = np.array([1.0, np.nan], dtype=np.float32)
    fig.add_trace({"type": "scatter", "x": x, "y": [1, None], "name": "</script>"}, row=2, col=1)
    fig.add_hline(y=1, line={"dash": "dash"}, row=1, col=1)
    text = fig.html("name", {"displaylogo": False})
    assert text.count("</script>") == 1
    name, (trace,), layout, _ = drawn(text)
    assert (name, trace["xaxis"], trace["yaxis"], trace["name"]) == (
        "name",
        "x3",
        "y3",
        "</script>",
    )
    assert trace["x"]["dtype"] == "f4" and trace["y"] == [1, None]
    read = np.frombuffer(base64.b64decode(trace["x"]["bdata"]), dtype=np.float32)
    np.testing.assert_array_equal(read, x)
    assert layout["shapes"][0]["xref"] == "x domain"


def test_an_equation_is_set_with_indices_powers_and_signs():
    shown = typeset("tau = fs exp(-|v / vs|^n) + (1 + k)^(1/p) sum_{k=1..6} ck kq")
    assert "τ = f<sub>s</sub> <b>exp</b>(−|v / v<sub>s</sub>|<sup>n</sup>)" in shown
    assert "<sup><b>1</b>/p</sup>" in shown and "∑<sub>k=<b>1</b>" in shown
    assert "c<sub>k</sub> kq" in shown and "<b>&lt;</b>" not in shown
    assert "<script>" not in typeset("tau = <script>x")


@pytest.mark.parametrize("effect", list(catalogue.table().values()), ids=lambda e: e.name)
def test_every_equation_of_the_catalogue_keeps_its_letters(effect):
    """Tags away, no mark of an index or a power is left, and every number is there."""
    plain = html.unescape(re.sub("<[^>]+>", "", typeset(effect.doc.equation)))
    assert not re.search(r"[_^][\w{(]", plain)
    digits = [c for c in effect.doc.equation if c.isdigit()]
    assert [c for c in plain if c.isdigit()] == digits
