"""A content security policy in every page of the site; `mkdocs.yml` names this file as a hook.

The scripts that stand in a page run by their digests, those of the site by their place, and
nothing is fetched from elsewhere.
"""

from __future__ import annotations

import base64
import hashlib
import re
from typing import Any

#: A script with its text in the page; data (JSON) are none.
_INLINE = re.compile(r"<script(?![^>]*\bsrc=)([^>]*)>(.*?)</script>", re.DOTALL)
_HEAD = re.compile(r"<head[^>]*>")


def policy(page: str) -> str:
    """Policy for the text of a page."""
    texts = [text for attributes, text in _INLINE.findall(page) if "json" not in attributes]
    digests = dict.fromkeys(
        base64.b64encode(hashlib.sha256(t.encode()).digest()).decode() for t in texts
    )
    scripts = " ".join(["'self'", *(f"'sha256-{d}'" for d in digests)])
    return (
        f"default-src 'none'; script-src {scripts}; style-src 'self' 'unsafe-inline'; "
        "img-src 'self' data:; font-src 'self'; connect-src 'self'; worker-src 'self'; "
        "manifest-src 'self'; base-uri 'self'; form-action 'self'"
    )


def guarded(page: str) -> str:
    """The page with its policy, before anything that it would forbid.

    Raises
    ------
    ValueError
        If the page has no head.
    """
    head = _HEAD.search(page)
    if head is None:
        raise ValueError("a page without <head> cannot take a content security policy")
    tag = f'<meta http-equiv="Content-Security-Policy" content="{policy(page)}">'
    return page[: head.end()] + tag + page[head.end() :]


def on_post_page(output: str, **_: Any) -> str:
    """Called by MkDocs for each page."""
    return guarded(output)


def on_post_template(output_content: str, template_name: str, **_: Any) -> str:
    """Called by MkDocs for each page of the theme, such as 404.html."""
    return guarded(output_content) if template_name.endswith(".html") else output_content
