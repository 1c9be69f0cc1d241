# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""One parameter: its type, default, unit, limits and text, and its declaration in a node."""

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from difflib import get_close_matches
import math
import re
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.node import Node
from rclpy.parameter import Parameter

from dg_localization.ros.executables import UsageError

LISTS = {str: Parameter.Type.STRING_ARRAY, float: Parameter.Type.DOUBLE_ARRAY}
TYPE_TEXTS = {str: 'a string', float: 'a number', int: 'an integer', bool: 'true or false'}
LIST_TEXTS = {str: 'a list of strings', float: 'a list of numbers'}
LARGEST_INTEGER = 2**63 - 1


class WrongParameterError(UsageError, ValueError):
    """A parameter of a node has a value that is not allowed."""


@contextmanager
def refused(beginning: str) -> Iterator[None]:
    """Convert a `ValueError` to a `WrongParameterError` whose text has this beginning."""
    try:
        yield
    except WrongParameterError:
        raise
    except ValueError as error:
        raise WrongParameterError(f'{beginning}{by_parameters(str(error))}') from None


def by_parameters(text: str) -> str:
    """Return a message about settings of the fleet with the names of their parameters."""
    # Settings have units in their names, and names of robots or points in brackets.
    text = re.sub(r'\[(\w+)\](?=[.:[])', r'.\1', text)
    text = re.sub(r'\bcoordinates_m\b', 'position', text)
    return re.sub(
        r'\b(min_error|max_error|min_reading|max_reading|position|elevations)_m\b', r'\1', text
    )


@dataclass(frozen=True)
class Spec:
    """
    A parameter.

    Attributes
    ----------
    default : object
        Value if it is not given; its type is the type of the parameter.
    description : str
        A description in one phrase.
    unit : str
        Unit; empty if there is none.
    at_least, at_most : float
        Limits of a number, or of each number of a list, both included; infinite for no limit.
    list_of : type
        `str` or `float`, for a list of these.
    finite, may_be_nan, may_be_zero, may_be_negative : bool
        Whether a number must be finite, and whether NaN, zero and negative numbers are allowed in
        addition to the limits.
    choices : tuple of str
        The allowed strings; empty for any.

    """

    default: Any
    description: str
    unit: str = ''
    at_least: float = -math.inf
    at_most: float = math.inf
    list_of: type | None = None
    finite: bool = True
    may_be_nan: bool = False
    may_be_zero: bool = False
    may_be_negative: bool = False
    choices: tuple[str, ...] = ()

    @property
    def type(self) -> Parameter.Type:
        """The ROS type."""
        if self.list_of:
            return LISTS[self.list_of]
        return Parameter.Type.from_parameter_value(self.default)

    def allowed(self) -> str:
        """Return a text on the allowed values."""
        kind = LIST_TEXTS[self.list_of] if self.list_of else TYPE_TEXTS[type(self.default)]
        if type(self.default) is float and self.finite and math.isinf(self.at_most):
            kind = 'a finite number'
        words = [self.limits()] if self.choices else [kind, self.limits()]
        return ' '.join(filter(None, [*words, self._in_unit()]))

    def limits(self) -> str:
        """Return the range of a number or the choices of a string; empty for any."""
        if self.choices:
            return ' or '.join(f"'{choice}'" for choice in self.choices)
        least = f'>= {self.at_least:g}' if self.at_least > -math.inf else ''
        most = f'<= {self.at_most:g}' if self.at_most < math.inf else ''
        text = ' and '.join(filter(None, [least, most]))
        if self.may_be_zero:
            text = f'0 or {text}'
        if self.may_be_nan:
            text = f'{text or "any number"} or .nan'
        return f'{text} or negative' if self.may_be_negative else text

    def _in_unit(self) -> str:
        return f'({self.unit})' if self.unit else ''

    def check(self, name: str, value: Any) -> Any:
        """
        Return the value of the parameter `name` with its type, or raise `WrongParameterError`.

        An integer is accepted as a number and `[]`, which arrives as None, as an empty list.
        """
        kind, items = self.list_of or type(self.default), [value]
        if self.list_of:
            is_list = isinstance(value, Iterable) and not isinstance(value, str | bytes)
            items = [] if value is None else list(value) if is_list else [None]
        if kind is float:
            items = [float(item) if type(item) is int else item for item in items]
        if not all(map(self._fits, items)):
            raise WrongParameterError(
                f"parameter '{name}': {value!r} is not allowed, it must be {self.allowed()}"
            )
        return items if self.list_of else items[0]

    def _fits(self, item: Any) -> bool:
        kind: Any = self.list_of or type(self.default)
        if type(item) is not kind:
            return False
        if type(item) is str:
            return not self.choices or item in self.choices
        if math.isnan(item):
            return self.may_be_nan
        if math.isinf(item) and self.finite:
            return False
        is_special = (item == 0 and self.may_be_zero) or (item < 0 and self.may_be_negative)
        return is_special or self.at_least <= item <= self.at_most

    def descriptor(self, read_only: bool = True) -> ParameterDescriptor:
        """Return the descriptor that `ros2 param describe` shows."""
        descriptor = ParameterDescriptor(
            description=' '.join(filter(None, [self.description, self._in_unit()])),
            additional_constraints=self.limits() if self.choices else '',
            type=self.type.value,
            read_only=read_only,
        )
        # In ROS .nan is outside of every range, so `check` compares these values instead.
        has_more = self.list_of or self.may_be_nan or self.may_be_negative
        if has_more or math.isinf(self.at_least) and math.isinf(self.at_most):
            return descriptor
        if type(self.default) is float:
            at_least = 0.0 if self.may_be_zero else self.at_least
            limits = FloatingPointRange(from_value=at_least, to_value=self.at_most)
            descriptor.floating_point_range = [limits]
        else:
            at_most = int(min(self.at_most, LARGEST_INTEGER))
            limits = IntegerRange(from_value=int(self.at_least), to_value=at_most, step=1)
            descriptor.integer_range = [limits]
        return descriptor


Specs = Mapping[str, Spec]
Hint = Callable[[str, Collection[str]], str]


def given_values(node: Node) -> dict[str, Any]:
    """
    Return the values of undeclared parameters of a node from files and command line.

    A check with good messages needs the values as given. The public interface is to declare them
    automatically; rclpy then refuses an empty list, with an error that names nothing.
    """
    overrides: Mapping[str, Parameter] = node._parameter_overrides
    return {name: p.value for name, p in overrides.items() if not node.has_parameter(name)}


def close_name(name: str, known: Iterable[str]) -> str:
    """Return the end of a sentence on an unknown name: a similar known name, if any."""
    close = get_close_matches(name, list(known), n=1)
    return f"; did you mean '{close[0]}'?" if close else ''


def checked(specs: Specs, given: Mapping[str, Any]) -> dict[str, Any]:
    """Return all values, given or default; raise `WrongParameterError` for a wrong one."""
    return {name: spec.check(name, given.get(name, spec.default)) for name, spec in specs.items()}


def refuse_unknown(given: Iterable[str], known: Collection[str], hint: Hint = close_name) -> None:
    """Raise `WrongParameterError` with a hint if a given name is unknown."""
    for name in given:
        # rclpy declares these for /clock, /parameter_events and /rosout, which may be remapped.
        if name not in known and not name.startswith('qos_overrides.'):
            raise WrongParameterError(f"parameter '{name}' is unknown{hint(name, known)}")


def declare(node: Node, specs: Specs, values: Mapping[str, Any], read_only: bool = True) -> None:
    """Declare the parameters that a node does not have yet, with checked values."""
    for name, spec in specs.items():
        if node.has_parameter(name):
            continue
        # rclpy infers the type from the value, and takes an empty list for a list of bytes. An
        # explicit type is possible only for a parameter without value, which is set afterwards.
        node.declare_parameter(name, spec.type, ignore_override=True)
        node.set_parameters([Parameter(name, spec.type, values[name])])
        node.set_descriptor(name, spec.descriptor(read_only))
