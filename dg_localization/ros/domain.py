"""A ROS 2 domain that no other process of this package on this machine uses."""

from dataclasses import dataclass
import fcntl
from pathlib import Path
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
            lock = open(folder / f'dg_localization_domain_{domain_id}.lock', 'w')
        except PermissionError:
            continue  # another user's claim
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            lock.close()
            continue
        return DomainClaim(domain_id, lock)
    raise RuntimeError(f'all ROS 2 domains from {DOMAIN_IDS[0]} to {DOMAIN_IDS[-1]} are taken')
