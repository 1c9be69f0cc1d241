# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
The executable `security_policy`: the SROS 2 policy of a localizer, from its own list.

    security_policy --params FILE [--enclave PATH] [--ros-args ...] > policy.xml
    ros2 security create_permission KEYSTORE /localizer policy.xml

The policy allows the topics and services of the node with these parameters and remappings, and
no others.
"""

import argparse
from collections.abc import Iterable, Sequence
from pathlib import Path
from xml.etree import ElementTree

from dg_localization.ros.hidden_node import hidden_localizer
from dg_localization.ros.interface.access import Access, access_of
from dg_localization.ros.interface.parameters.settings import declare_settings
from dg_localization.ros.spinning import own_arguments

VERSION = '0.2.0'


def as_policy(access: Access, namespace: str, node: str, enclave: str) -> str:
    """
    Return a policy as XML.

    Parameters
    ----------
    access : Access
        What is allowed.
    namespace, node : str
        Whom it is allowed.
    enclave : str
        Path of the enclave of its process.

    """
    policy = ElementTree.Element('policy', version=VERSION)
    place = ElementTree.SubElement(policy, 'enclaves')
    place = ElementTree.SubElement(place, 'enclave', path=enclave)
    place = ElementTree.SubElement(place, 'profiles')
    profile = ElementTree.SubElement(place, 'profile', ns=namespace, node=node)
    _allow(profile, 'service', 'reply', access.serves)
    _allow(profile, 'topic', 'publish', access.publishes)
    _allow(profile, 'topic', 'subscribe', access.subscribes)
    ElementTree.indent(policy)
    text = ElementTree.tostring(policy, encoding='unicode')
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{text}\n'


def _allow(profile: ElementTree.Element, tag: str, act: str, names: Iterable[str]) -> None:
    names = tuple(names)
    if names:
        allowed = ElementTree.SubElement(profile, f'{tag}s', {act: 'ALLOW'})
        for name in names:
            ElementTree.SubElement(allowed, tag).text = name


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    parser = argparse.ArgumentParser(
        prog='security_policy', description='Print the SROS 2 policy of a localizer.'
    )
    parser.add_argument(
        '--params', type=Path, required=True, metavar='FILE', help='parameters of the localizer'
    )
    parser.add_argument(
        '--enclave',
        metavar='PATH',
        help='enclave of its process (default: the full name of the node)',
    )
    return parser


def main(args: Sequence[str]) -> int:
    """
    Print the policy; return the exit code.

    Parameters
    ----------
    args : sequence of str
        Command line.

    Raises
    ------
    UsageError
        If an argument or a parameter is wrong.

    """
    options = make_parser().parse_args(own_arguments(args))
    with hidden_localizer(options.params, args) as node:
        access = access_of(node, declare_settings(node))
        enclave = options.enclave or node.get_fully_qualified_name()
        text = as_policy(access, node.get_namespace(), node.get_name(), enclave)
    print(text, end='')
    return 0
