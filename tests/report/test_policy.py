"""Content security policy of a page: its own two scripts run, and nothing else does anything."""

import base64
import hashlib
import json
import re

from hil.report.elements import Panels, document, escape


def page(body: str = "", figures: bool = True) -> str:
    return document("title", body, figures)


def policy(text: str) -> dict[str, list[str]]:
    found = re.search(r'<meta http-equiv="Content-Security-Policy" content="([^"]*)">', text)
    parts = (p.split() for p in found[1].split(";"))
    return {name: values for name, *values in parts}


def digest(script: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()}'"


def test_the_scripts_of_the_page_and_no_other():
    for figures in (True, False):
        text = page("<script>alert(1)</script>", figures)
        rules = policy(text)
        scripts = re.findall("<script>(.*?)</script>", text, re.DOTALL)
        own = [digest(s) for s in scripts if "alert(1)" not in s]
        assert len(own) == 1 + figures and rules["script-src"] == own
        assert digest("alert(1)") not in rules["script-src"]


def test_nothing_is_fetched_or_sent():
    rules = policy(page())
    assert rules["default-src"] == ["'none'"]
    assert rules["form-action"] == rules["base-uri"] == ["'none'"]
    assert not any("http" in v or v == "*" for values in rules.values() for v in values)
    assert "'unsafe-inline'" not in rules["script-src"]
    # the policy comes before anything that it is to govern
    text = page()
    assert text.index("Content-Security-Policy") < text.index("<style>") < text.index("<script>")


def test_figures_are_data_and_not_scripts():
    panels = Panels([100.0], 1, 0.0, 0.0, ["</script><script>alert(1)</script>"])
    panels.add_trace({"x": [0.0, float("nan"), 1.0], "y": [1, 2, float("inf")]})
    panels.update_layout(height=100, width=100)
    text = panels.html("f", {})
    kinds = re.findall(r"<script([^>]*)>", text)
    assert kinds == [' type="application/json" class="figure"']
    data = json.loads(re.search(r'class="figure">(.*?)</script>', text)[1])
    assert data[0] == "f" and data[1][0]["x"] == [0.0, None, 1.0] and data[1][0]["y"][2] is None


def test_marks_that_turn_text_are_shown():
    assert escape("a\u202eb\x1b<") == r"a\u202eb\x1b&lt;"
