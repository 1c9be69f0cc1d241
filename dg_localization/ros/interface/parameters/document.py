# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The commented file of parameters, which is their documentation, written from the table."""

import math
from pathlib import Path
import sys
import textwrap
from typing import Any

from dg_localization.ros.interface.parameters.spec import LIST_TEXTS, Section, Spec
from dg_localization.ros.interface.parameters.table import OWN, SECTIONS

WIDTH = 99

YAML_HEAD = """\
# Every parameter of the node `localizer`, with its default. Start from this file:
#   ros2 run dg_localization localizer --ros-args --params-file localizer.yaml
# Units and limits are in brackets, and defaults show the types: 2.0 is a number, 2 an integer.
# A wrong value or a misspelled name is refused at start.
# Written from the table of parameters by `make parameters`; do not edit.
/**:
  ros__parameters:
"""


def as_yaml() -> str:
    """Return the commented file with every parameter and its default."""
    own = ['', '    # --- What one robot, sensor, point or anchor has of its own ---']
    for name, spec in OWN.items():
        own += _comment(f'{name}: {_value(spec.default)}. {_sentences(spec)}', 4)
    return YAML_HEAD + ''.join(map(_yaml_section, SECTIONS)) + '\n'.join(own) + '\n'


def _yaml_section(section: Section) -> str:
    lines = ['', f'    # --- {section.title} ---', *_comment(section.text, 4)]
    group = ''
    for full_name, spec in section.specs.items():
        prefix, _, name = full_name.rpartition('.')
        if prefix and prefix != group:
            lines.append(f'    {prefix}:')
        group = prefix
        indent = 6 if prefix else 4
        lines += _comment(_sentences(spec), indent)
        lines += [f'{" " * indent}#   {line}' for line in spec.examples]
        value = spec.default if spec.shown is None else spec.shown
        lines.append(f'{" " * indent}{name}: {_value(value)}')
    return '\n'.join(lines) + '\n'


def _sentences(spec: Spec) -> str:
    """Return the text of a parameter, with its unit and limits, and what a list is of."""
    kind = LIST_TEXTS[spec.list_of] if spec.list_of else ''
    facts = ', '.join(filter(None, [kind, spec.unit, spec.limits()]))
    first, _, rest = spec.text.partition('. ')
    first = f'{first[0].upper()}{first[1:].removesuffix(".")}{facts and f" ({facts})"}.'
    return f'{first} {rest}'.rstrip()


def _comment(text: str, indent: int) -> list[str]:
    prefix = ' ' * indent + '# '
    return textwrap.wrap(
        text,
        WIDTH,
        initial_indent=prefix,
        subsequent_indent=prefix,
        break_on_hyphens=False,
        break_long_words=False,
    )


def _value(value: Any) -> str:
    """Return a value as YAML."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return f"'{value}'"
    if isinstance(value, float) and not math.isfinite(value):
        return f'{value}'.replace('inf', '.inf').replace('nan', '.nan')
    return str(value)


def main() -> None:
    """Write the file into a repository, by default that of the working directory."""
    repository = Path(sys.argv[1] if len(sys.argv) > 1 else '.')
    (repository / 'config/localizer.yaml').write_text(as_yaml(), encoding='utf-8')


if __name__ == '__main__':
    main()
