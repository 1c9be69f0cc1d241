# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The commented file of parameters and their documentation, both written from the table."""

from collections.abc import Iterator, Mapping
import math
from pathlib import Path
import sys
import textwrap
from typing import Any

from dg_localization.ros.interface.parameters.spec import Section, Spec, Specs
from dg_localization.ros.interface.parameters.table import NAMED, SECTIONS

WIDTH = 99

YAML_HEAD = """\
# Every parameter of the node `localizer`, with its default. Start from this file:
#   ros2 run dg_localization localizer --ros-args --params-file localizer.yaml
# Units are in brackets. A wrong value or a misspelled name is refused at start.
# Written from the table of parameters by `make parameters`; do not edit.
/**:
  ros__parameters:
"""

PAGE_HEAD = """\
# Parameters

The parameters of the node `localizer`, which `localize_bag` takes too. They are set at start by a
file (`--ros-args --params-file FILE`) or one by one (`-p NAME:=VALUE`), and while the node runs by
`ros2 param set`. Rates, ages, bounds and limits take effect at once. What makes the fleet, its
inputs and its outputs does so at the next `configure`. A wrong value is refused with a message
that names what is allowed. `config/localizer.yaml` holds all parameters with their defaults.

Where a parameter is given twice, by two files or by a file and `-p`, give it the same type both
times: write `2.0`, not `2`, for a number. Of two values of different types ROS 2 may keep the
first, without a message: after `max_speed: 2` in a file, `-p max_speed:=2.5` has no effect.

This page is written by `make parameters`; a test keeps it true.
"""


def as_yaml() -> str:
    """Return the commented file with every parameter and its default."""
    return YAML_HEAD + ''.join(_yaml_section(section) for section in SECTIONS)


def _yaml_section(section: Section) -> str:
    lines = ['', f'    # --- {section.title} ---', *_comment(section.text, 4)]
    group = ''
    for full_name, spec in section.specs.items():
        prefix, _, name = full_name.rpartition('.')
        if prefix and prefix != group:
            lines.append(f'    {prefix}:')
        group = prefix
        indent = 6 if prefix else 4
        lines += _comment(
            _sentences(spec, ', '.join(filter(None, [spec.unit, spec.limits()]))), indent
        )
        lines += [f'{" " * indent}#   {line}' for line in spec.examples]
        value = spec.default if spec.shown is None else spec.shown
        lines.append(f'{" " * indent}{name}: {_value(value)}')
    return '\n'.join(lines) + '\n'


def _sentences(spec: Spec, facts: str = '') -> str:
    """Return the text of a parameter in sentences, with its unit and limits in the first."""
    first, _, rest = spec.text.partition('. ')
    facts = f' ({facts})' if facts else ''
    return f'{first[0].upper()}{first[1:].removesuffix(".")}{facts}. {rest}'.rstrip()


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


def as_markdown() -> str:
    """Return the page of documentation."""
    return '\n'.join([PAGE_HEAD, *_page_parts()])


def _page_parts() -> Iterator[str]:
    for section in SECTIONS:
        yield f'## {section.title}\n'
        if section.text:
            yield '\n'.join(textwrap.wrap(section.text, WIDTH, break_on_hyphens=False)) + '\n'
        named: Mapping[str, Spec] = {
            name: spec
            for one in NAMED
            if one.section is section
            for name, spec in one.specs.items()
        }
        yield _table({**section.specs, **named})
        examples = [
            line for name, spec in section.specs.items() for line in _whole_example(name, spec)
        ]
        if examples:
            yield '\n'.join(['```yaml', *examples, '```\n'])


def _whole_example(name: str, spec: Spec) -> list[str]:
    """Return the lines of an example with the group that they stand in."""
    group = name.rpartition('.')[0]
    if not group or not spec.examples:
        return list(spec.examples)
    return [f'{group}:', *(f'  {line}' for line in spec.examples)]


def _table(specs: Specs) -> str:
    rows = [
        '| parameter | type | default | unit | allowed values | |',
        '|---|---|---|---|---|---|',
    ]
    for name, spec in specs.items():
        kind = spec.type.name.lower().replace('_array', ' list')
        facts = kind, f'`{_value(spec.default)}`', spec.unit, spec.limits(), _sentences(spec)
        cells = ' | '.join(cell.replace('|', '\\|') for cell in (f'`{name}`', *facts))
        rows.append(f'| {cells} |')
    return '\n'.join(rows) + '\n'


def main() -> None:
    """Write both files into a repository, by default that of the working directory."""
    repository = Path(sys.argv[1] if len(sys.argv) > 1 else '.')
    (repository / 'config/localizer.yaml').write_text(as_yaml(), encoding='utf-8')
    (repository / 'docs/parameters.md').write_text(as_markdown(), encoding='utf-8')


if __name__ == '__main__':
    main()
