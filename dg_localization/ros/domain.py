# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""A ROS 2 domain that no other process of this package on this machine uses."""

import os
import socket

# Domains 1 to 101 keep DDS below the ephemeral ports of Linux; 0 is the common default.
DOMAIN_IDS = range(1, 102)
FIRST_PORT = 30_000

_claims: list[socket.socket] = []


def claim_domain() -> int:
    """
    Take a free domain of this machine for this process and its children, as ament's tests do.

    It is set as ROS_DOMAIN_ID, and a bound port reserves it until the process ends. Processes that
    chose their domain otherwise are not detected. RuntimeError is raised if all are taken.
    """
    for domain_id in DOMAIN_IDS:
        claim = socket.socket()
        try:
            claim.bind(('127.0.0.1', FIRST_PORT + domain_id))
        except OSError:
            claim.close()
            continue
        _claims.append(claim)
        os.environ['ROS_DOMAIN_ID'] = str(domain_id)
        os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
        return domain_id
    raise RuntimeError(f'all ROS 2 domains from {DOMAIN_IDS[0]} to {DOMAIN_IDS[-1]} are taken')
