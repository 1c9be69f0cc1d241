# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""A ROS 2 domain that no other process of this package on this machine uses."""

from dataclasses import dataclass
import fcntl
import os
from pathlib import Path
import stat
import tempfile
from typing import IO

# Domains 1 to 101 keep DDS below the ephemeral ports of Linux; 0 is everybody's default.
DOMAIN_IDS = range(1, 102)


@dataclass(frozen=True)
class DomainClaim:
    """
    A domain, taken until `release` or the end of the process.

    Attributes
    ----------
    domain_id : int
        The value for ROS_DOMAIN_ID.
    lock : file object
        The lock that holds the claim.

    """

    domain_id: int
    lock: IO[str]

    def release(self) -> None:
        """Give the domain back."""
        self.lock.close()


def claim_domain() -> DomainClaim:
    """
    Take a domain that is free on this machine.

    Only processes that ask here are seen: a fleet that runs on a domain of its own choice is not.

    Returns
    -------
    DomainClaim
        The domain, held by a file lock in the temporary folder.

    Raises
    ------
    RuntimeError
        If all domains are taken.

    """
    folder = Path(tempfile.gettempdir())
    for domain_id in reversed(DOMAIN_IDS):
        try:
            lock = _open_lock(folder / f'dg_localization_domain_{domain_id}.lock')
        except OSError:
            continue  # the claim of another user, or no file of ours
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            lock.close()
            continue
        return DomainClaim(domain_id, lock)
    raise RuntimeError(f'all ROS 2 domains from {DOMAIN_IDS[0]} to {DOMAIN_IDS[-1]} are taken')


def _open_lock(path: Path) -> IO[str]:
    """
    Open a file for its lock, and make it if it is not there; its content is left alone.

    The folder is shared: another user may have put a link, a pipe or a device in its place.

    Raises
    ------
    OSError
        If it is no file of this user.

    """
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK, 0o600)
    status = os.fstat(descriptor)
    if not stat.S_ISREG(status.st_mode) or status.st_uid != os.geteuid():
        os.close(descriptor)
        raise PermissionError(f'{path} is no file of this user')
    return os.fdopen(descriptor, 'r+')
