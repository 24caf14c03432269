"""The page for a browser that is not signed in: a field for the address. Pure.

It stands alone: the page's own files are for browsers that are signed in. It needs no script, as the field is a form
that asks for `/?token=…` itself; whatever is pasted there goes through `skygcs.web.sign_in.token_of`.
"""

from __future__ import annotations

import base64
import hashlib

STYLE = """
:root{color-scheme:dark light;--ground:#0d1319;--surface:#141c24;--edge:#2b3947;--strong:#6b7d8f;--text:#e8eef4;
--muted:#9fb0c0;--accent:#4db8ff;--on-accent:#04111c;--danger:#ff7b72}
@media (prefers-color-scheme:light){:root{--ground:#f7f9fb;--surface:#fff;--edge:#cdd6df;--strong:#66757f;
--text:#0b1620;--muted:#465462;--accent:#0060a8;--on-accent:#fff;--danger:#b91212}}
*{box-sizing:border-box}
body{margin:0;min-height:100vh;min-height:100dvh;display:grid;place-items:center;padding:16px;background:var(--ground);
color:var(--text);font:16px/1.5 system-ui,-apple-system,"Segoe UI",Roboto,"Liberation Sans",Arial,sans-serif}
main{width:100%;max-width:480px;padding:28px;border:1px solid var(--edge);border-radius:10px;background:var(--surface)}
h1{display:flex;align-items:center;gap:10px;margin:0 0 16px;font-size:20px}
svg{fill:var(--accent)}
p{margin:0 0 16px}
label{display:block;margin-bottom:6px;font-weight:600}
input{width:100%;min-height:48px;padding:0 12px;border:1px solid var(--strong);border-radius:6px;
background:var(--ground);color:var(--text);font:inherit}
input::placeholder{color:var(--muted);opacity:1}
input[aria-invalid]{border-color:var(--danger)}
button{width:100%;min-height:48px;margin:12px 0 20px;border:0;border-radius:6px;background:var(--accent);
color:var(--on-accent);font:inherit;font-weight:600;cursor:pointer}
:focus-visible{outline:2px solid var(--accent);outline-offset:2px}
code{display:inline-block;padding:0 6px;border:1px solid var(--edge);border-radius:4px;background:var(--ground);
font:14px/1.6 ui-monospace,Menlo,Consolas,"Liberation Mono",monospace}
ul{margin:0 0 16px;padding-left:20px}
.muted{margin:0;color:var(--muted);font-size:14px}
a{color:var(--accent)}
.bad{color:var(--danger)}
"""

STYLE_SOURCE = f"'sha256-{base64.b64encode(hashlib.sha256(STYLE.encode()).digest()).decode()}'"
"""Allows this style, and no other, in the page's Content-Security-Policy."""

_REFUSED = """<p class="bad" id="refused" role="alert">This address is not good any more: it was used, is older than an
hour, or was copied in part. Get a new one.</p>"""


def sign_in_page(*, refused: bool) -> str:
    """The page. ``refused``: an address was tried."""
    invalid = ' aria-invalid="true" aria-describedby="refused"' if refused else ""
    return f"""<!doctype html><html lang="en"><head><meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1"><meta name="color-scheme" content="dark light">
<title>Sign in to skygcs</title><style>{STYLE}</style></head><body><main>
<h1><svg viewBox="0 0 24 24" width="28" height="28" aria-hidden="true"><path d="M12 2 20 21 12 17 4 21z"/></svg>
skygcs</h1>
{_REFUSED if refused else "<p>This browser is not signed in.</p>"}
<form action="/" method="get" autocomplete="off"><label for="token">Address of the page</label>
<input id="token" name="token" type="text" inputmode="url" required autofocus autocapitalize="none" spellcheck="false"
placeholder="http://…/?token=…"{invalid}><button type="submit">Sign in</button></form>
<p>On the ground station's computer:</p>
<ul><li><code>skygcs web link</code> for a browser that may order</li>
<li><code>skygcs web link --view</code> for one that may only look</li></ul>
<p class="muted">An address works once, within an hour. Signed in before, and came here by a link?
<a href="/">Continue</a>.</p></main></body></html>"""
