# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The registry of adapters by message type; users add their own with `register`."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from msg_adapters.headers import message_class


class UnknownTypeError(KeyError, ValueError):
    """No adapter is registered for the message type, or its package is not installed."""

    def __str__(self) -> str:
        return str(self.args[0])


@dataclass(frozen=True)
class Adapter:
    """
    Both directions between one message type and plain values.

    Attributes
    ----------
    type_name : str
        Such as 'sensor_msgs/msg/Range'.
    value_class : type
        Class of the plain values; it determines the use of a message.
    from_message : callable
        Message to value. It may raise ValueError on a message that is no reading.
    to_message : callable
        Value to message.

    """

    type_name: str
    value_class: type
    from_message: Callable[[Any], Any]
    to_message: Callable[[Any], Any]

    def message_class(self) -> type:
        """
        Import and return the message class; nothing is imported before this call.

        Raises
        ------
        UnknownTypeError
            If the package is not installed or has no such message.

        """
        try:
            found: type = message_class(self.type_name)
        except (ImportError, AttributeError) as error:
            advice = f'install the ROS package {self.type_name.partition("/")[0]}'
            raise UnknownTypeError(f'{self.type_name} cannot be imported; {advice}') from error
        return found


_adapters: dict[str, Adapter] = {}


def register(adapter: Adapter) -> None:
    """
    Add an adapter, replacing the one for the same type.

    Raises
    ------
    ValueError
        If the type name is not of the form 'package/msg/Type'.

    """
    parts = adapter.type_name.split('/')
    if len(parts) != 3 or not all(parts):
        raise ValueError(f"type name '{adapter.type_name}' is not of the form 'package/msg/Type'")
    _adapters[adapter.type_name] = adapter


def adapter_for(type_name: str) -> Adapter:
    """
    Return the adapter of a message type, such as 'sensor_msgs/msg/Range'.

    Raises
    ------
    UnknownTypeError
        If there is no adapter; the message lists the known types.

    """
    try:
        return _adapters[type_name]
    except KeyError:
        raise UnknownTypeError(
            f"no adapter for message type '{type_name}'; there are {', '.join(known_types())}"
        ) from None


def known_types() -> list[str]:
    """Return the names of all message types that have an adapter, sorted."""
    return sorted(_adapters)


def register_cdr(
    type_name: str,
    value_class: type,
    from_message: Callable[[Any], Any],
    to_cdr: Callable[[Any], bytes],
) -> Callable[[Any], Any]:
    """Add an adapter that writes serialized messages; return its `to_message`."""

    def to_message(value: Any) -> Any:
        from rclpy.serialization import deserialize_message

        return deserialize_message(to_cdr(value), message_class(type_name))

    register(Adapter(type_name, value_class, from_message, to_message))
    return to_message
