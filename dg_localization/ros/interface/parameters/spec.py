# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""One parameter: its name, type, default, unit, limits and text, and how a node declares it."""

from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
import math
import re
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.node import Node
from rclpy.parameter import Parameter

from dg_localization.ros.executables import UsageError

STRINGS = Parameter.Type.STRING_ARRAY
DOUBLES = Parameter.Type.DOUBLE_ARRAY
DOUBLE = Parameter.Type.DOUBLE
INTEGER = Parameter.Type.INTEGER
STRING = Parameter.Type.STRING
BOOL = Parameter.Type.BOOL

TYPE_TEXTS = {
    STRINGS: 'a list of strings',
    DOUBLES: 'a list of numbers',
    DOUBLE: 'a number',
    INTEGER: 'an integer',
    STRING: 'a string',
    BOOL: 'true or false',
}
LARGEST_INTEGER = 2**63 - 1


class WrongParameterError(UsageError, ValueError):
    """A parameter of a node has a value that is not allowed."""


def by_parameters(text: str) -> str:
    """
    Return what the fleet says of its settings with the names of their parameters.

    Settings have units in their names, and those of one robot or point stand in brackets.
    """
    text = re.sub(r'\[(\w+)\](?=[.:[])', r'.\1', text)
    return re.sub(
        r'\b(min_error|max_error|min_reading|max_reading|position|elevations)_m\b', r'\1', text
    )


@dataclass(frozen=True)
class Spec:
    """
    One row of a parameter table.

    Attributes
    ----------
    name : str
        Name, with dots.
    type : Parameter.Type
        One of `TYPE_TEXTS`.
    default : object
        Value when it is not given.
    description : str
        What it is, in one phrase without a final stop.
    unit : str
        Unit; empty for what has none.
    at_least, at_most : float
        Limits of a number, or of each number of a list, both included; infinite for none.
    finite : bool
        Whether a number may not be infinite.
    may_be_nan : bool
        Whether NaN is allowed, for a number that is not known.
    may_be_zero : bool
        Whether 0 is allowed, too, for what is then off.
    choices : tuple of str
        The allowed strings; empty for any.
    details : str
        Further sentences for the commented file and the documentation.
    examples : tuple of str
        Lines of YAML that the commented file shows as comments.
    shown : object
        Value in the commented file where the default alone is refused; None for the default.

    """

    name: str
    type: Parameter.Type
    default: Any
    description: str
    unit: str = ''
    at_least: float = -math.inf
    at_most: float = math.inf
    finite: bool = True
    may_be_nan: bool = False
    may_be_zero: bool = False
    choices: tuple[str, ...] = ()
    details: str = ''
    examples: tuple[str, ...] = ()
    shown: Any = None

    def allowed(self) -> str:
        """Return what the value may be, in words."""
        words = [TYPE_TEXTS[self.type], self.limits()]
        if self.type is DOUBLE and self.finite and math.isinf(self.at_most):
            words[0] = 'a finite number'
        if self.choices:
            words = [self.limits()]
        return ' '.join(filter(None, [*words, self._in_unit()]))

    def limits(self) -> str:
        """Return the range of a number or the choices of a string; empty for any."""
        if self.choices:
            return ' or '.join(f"'{choice}'" for choice in self.choices)
        limits = []
        if self.at_least > -math.inf:
            limits.append(f'>= {self.at_least:g}')
        if self.at_most < math.inf:
            limits.append(f'<= {self.at_most:g}')
        text = ' and '.join(limits)
        if self.may_be_zero:
            text = f'0 or {text}'
        return f'{text or "any number"} or .nan' if self.may_be_nan else text

    def _in_unit(self) -> str:
        return f'({self.unit})' if self.unit else ''

    def check(self, value: Any) -> Any:
        """
        Return `value` with the type of the table.

        An integer is accepted as a number and `[]`, which arrives as None, as an empty list, as
        a person writing YAML means them.

        Raises
        ------
        WrongParameterError
            If the value is not allowed.

        """
        if self.type in (STRINGS, DOUBLES):
            value = _as_list(value)
        if self.type is DOUBLE:
            value = _as_float(value)
        if self.type is DOUBLES and type(value) is list:
            value = [_as_float(item) for item in value]
        if not self._fits(value):
            raise WrongParameterError(
                f"parameter '{self.name}': {value!r} is not allowed, it must be {self.allowed()}"
            )
        return value

    def _fits(self, value: Any) -> bool:
        if self.type is STRINGS:
            return type(value) is list and all(type(item) is str for item in value)
        if self.type is DOUBLES:
            return type(value) is list and all(
                type(item) is float and math.isfinite(item) and self._is_within(item)
                for item in value
            )
        if self.type in (DOUBLE, INTEGER):
            number = float if self.type is DOUBLE else int
            if type(value) is not number:
                return False
            if math.isnan(value):
                return self.may_be_nan
            return self._is_within(value) and (math.isfinite(value) or not self.finite)
        if self.type is BOOL:
            return type(value) is bool
        return type(value) is str and (not self.choices or value in self.choices)

    def _is_within(self, number: float) -> bool:
        """Return whether a number is within the limits."""
        if number == 0.0 and self.may_be_zero:
            return True
        return self.at_least <= number <= self.at_most

    def descriptor(self, read_only: bool = True) -> ParameterDescriptor:
        """Return the descriptor that `ros2 param describe` shows."""
        descriptor = ParameterDescriptor(
            description=' '.join(filter(None, [self.description, self._in_unit()])),
            additional_constraints=self.limits() if self.choices else '',
            type=self.type.value,
            read_only=read_only,
        )
        bounded = math.isfinite(self.at_least) or math.isfinite(self.at_most)
        # ROS takes .nan to be out of every range; `check` knows better.
        if self.type is DOUBLE and bounded and not self.may_be_nan:
            at_least = 0.0 if self.may_be_zero else self.at_least
            limits = FloatingPointRange(from_value=at_least, to_value=self.at_most)
            descriptor.floating_point_range = [limits]
        if self.type is INTEGER and bounded:
            at_most = int(min(self.at_most, LARGEST_INTEGER))
            limits = IntegerRange(from_value=int(self.at_least), to_value=at_most, step=1)
            descriptor.integer_range = [limits]
        return descriptor


def _as_list(value: Any) -> Any:
    """Return a list for None and for what holds several values; a string is one value."""
    if value is None:
        return []
    return list(value) if isinstance(value, Iterable) and not isinstance(value, str) else value


def _as_float(value: Any) -> Any:
    return float(value) if type(value) is int else value


def given_values(node: Node) -> dict[str, Any]:
    """
    Return what files and command line give for the parameters of a node that are not declared.

    A check that names what is right needs them as they were given. The public way is to have them
    declared automatically; rclpy then refuses an empty list, with an error that names nothing.
    """
    overrides: Mapping[str, Parameter] = node._parameter_overrides
    return {name: p.value for name, p in overrides.items() if not node.has_parameter(name)}


def close_name(name: str, known: Iterable[str]) -> str:
    """Return the end of a sentence on an unknown name: which one may be meant, if any."""
    close = get_close_matches(name, list(known), n=1)
    return f"; did you mean '{close[0]}'?" if close else ''


def refuse_unknown(
    given: Iterable[str],
    known: Collection[str],
    hint: Callable[[str, Iterable[str]], str] = close_name,
) -> None:
    """Raise `WrongParameterError`, with a hint, where a name that is given is not known."""
    for name in given:
        # rclpy declares those of /clock, /parameter_events and /rosout by whatever name they have.
        if name not in known and not name.startswith('qos_overrides.'):
            raise WrongParameterError(f"parameter '{name}' is unknown{hint(name, known)}")


def declare(
    node: Node, specs: Iterable[Spec], values: Mapping[str, Any], read_only: bool = True
) -> None:
    """Declare parameters on a node, with checked values."""
    for spec in specs:
        # rclpy infers the type from the value, and takes an empty list for a list of bytes. A
        # type of its own can be given only to a parameter without value, which is set after.
        node.declare_parameter(spec.name, spec.type, ignore_override=True)
        node.set_parameters([Parameter(spec.name, spec.type, values[spec.name])])
        node.set_descriptor(spec.name, spec.descriptor(read_only))


@dataclass(frozen=True)
class Section:
    """Parameters that belong together: a title, what they have in common, and their rows."""

    title: str
    text: str
    specs: tuple[Spec, ...]
