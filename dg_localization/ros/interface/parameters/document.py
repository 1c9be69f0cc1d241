# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The commented file of parameters and their documentation, both written from the table."""

from collections.abc import Iterable, Iterator
import math
import textwrap
from typing import Any

from dg_localization.ros.interface.parameters.odometry import robot_odometry_specs
from dg_localization.ros.interface.parameters.points import (
    anchor_specs,
    elevation_spec,
    mount_specs,
)
from dg_localization.ros.interface.parameters.spec import (
    BOOL,
    DOUBLE,
    DOUBLES,
    INTEGER,
    STRING,
    STRINGS,
    Spec,
)
from dg_localization.ros.interface.parameters.table import (
    SECTIONS,
    Section,
    robot_spec,
)

WIDTH = 99
TYPE_NAMES = {
    STRINGS: 'string list',
    DOUBLES: 'number list',
    DOUBLE: 'number',
    INTEGER: 'integer',
    STRING: 'string',
    BOOL: 'boolean',
}

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
    for spec in section.specs:
        prefix, _, name = spec.name.rpartition('.')
        if prefix and prefix != group:
            lines.append(f'    {prefix}:')
        group = prefix
        indent = 6 if prefix else 4
        lines += _comment(_sentences(spec), indent)
        lines += [f'{" " * indent}#   {line}' for line in spec.examples]
        lines.append(
            f'{" " * indent}{name}: {_value(spec.default if spec.shown is None else spec.shown)}'
        )
    return '\n'.join(lines) + '\n'


def _sentences(spec: Spec) -> str:
    """Return the text of a parameter: what it is, its unit and limits, and the details."""
    facts = ', '.join(filter(None, [spec.unit, spec.limits()]))
    facts = f' ({facts})' if facts else ''
    return ' '.join(filter(None, [f'{_capitalized(spec.description)}{facts}.', spec.details]))


def _capitalized(text: str) -> str:
    return text[0].upper() + text[1:]


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
    if value != value:
        return '.nan'
    if value in (math.inf, -math.inf):
        return '.inf' if value > 0.0 else '-.inf'
    return str(value)


def as_markdown() -> str:
    """Return the page of documentation."""
    return '\n'.join([PAGE_HEAD, *_page_parts()])


def _page_parts() -> Iterator[str]:
    for section in SECTIONS:
        yield f'## {section.title}\n'
        if section.text:
            yield '\n'.join(textwrap.wrap(section.text, WIDTH, break_on_hyphens=False)) + '\n'
        yield _table(_with_named(section.specs))
        examples = [line for spec in section.specs for line in _whole_example(spec)]
        if examples:
            yield '\n'.join(['```yaml', *examples, '```\n'])


def _whole_example(spec: Spec) -> list[str]:
    """Return the lines of an example with the group that they stand in."""
    group = spec.name.rpartition('.')[0]
    if not group or not spec.examples:
        return list(spec.examples)
    return [f'{group}:', *(f'  {line}' for line in spec.examples)]


def _with_named(specs: Iterable[Spec]) -> Iterator[Spec]:
    """Yield the rows of a section, with those that each robot, anchor or sensor has of its own."""
    for spec in specs:
        yield spec
        if spec.name == 'max_speed':
            yield robot_spec('NAME')
        if spec.name == 'odometry.tilt':
            yield from robot_odometry_specs('NAME')
        if spec.name == 'anchors.bound':
            yield from anchor_specs('NAME')
        if spec.name == 'mounts.names':
            yield from mount_specs('ROBOT/SENSOR')
        if spec.name == 'elevations.names':
            yield elevation_spec('NAME')


def _table(specs: Iterable[Spec]) -> str:
    rows = [
        '| parameter | type | default | unit | allowed values | |',
        '|---|---|---|---|---|---|',
    ]
    for spec in specs:
        cells = [
            f'`{spec.name}`',
            TYPE_NAMES[spec.type],
            f'`{_value(spec.default)}`',
            spec.unit,
            spec.limits(),
            ' '.join(filter(None, [f'{_capitalized(spec.description)}.', spec.details])),
        ]
        rows.append('| ' + ' | '.join(cell.replace('|', '\\|') for cell in cells) + ' |')
    return '\n'.join(rows) + '\n'
