"""What LiteX writes, with the same bytes every time."""

import re


def verilog(text):
    """LiteX's Verilog without the date and the drawings, which have no fixed order: what has not
    changed is not built again."""
    text = re.sub(r"^/\*.*?^\*/$", "", text[text.index("`timescale"):], flags=re.M | re.S)
    return "".join(line for line in text.splitlines(keepends=True) if not line.startswith("//"))
