"""Formulas as MathML, made when the site is built: a reader needs no script and no network.

A formula that cannot be converted ends the build.
"""

import html
import re

from math_core import LatexError, LatexToMathML
from mkdocs.exceptions import PluginError

_FORMULA = re.compile(r'<(span|div) class="arithmatex">\s*\\[(\[](.*?)\\[)\]]\s*</\1>', re.DOTALL)
_converter = LatexToMathML()


def on_page_content(content, page, config, files):
    def converted(match):
        block, formula = match.group(1) == "div", html.unescape(match.group(2)).strip()
        try:
            mathml = _converter.convert_with_local_state(formula, displaystyle=block)
        except LatexError as e:
            raise PluginError(f"{page.file.src_uri}: cannot convert {formula!r}: {e}") from None
        return f'<div class="formula">{mathml}</div>' if block else mathml

    return _FORMULA.sub(converted, content)
