"""A ROS domain of one's own: graphs on one machine, and robots beside it, never meet."""
from functools import cache
import os
import socket

from neo_ros.errors import NeoError

# The ports of ids above 101 are those that Linux gives to anybody; 0 is everybody's.
DOMAINS = range(1, 101)
_held: list[socket.socket] = []


@cache
def own_domain(number: int = 0) -> int:
    """
    Return a domain id that no other process of this machine holds, the same at every call.

    number: of several, which are different ones.
    It is held by a name that the kernel frees when the process ends, however it ends. The domain
    in ROS_DOMAIN_ID is a robot's and never taken. Raises NeoError where all are held.
    """
    first = os.getpid()
    for step in range(len(DOMAINS)):
        domain = DOMAINS[(first + number + step) % len(DOMAINS)]
        if str(domain) == os.environ.get('ROS_DOMAIN_ID', ''):
            continue
        holder = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        try:
            holder.bind(f'\0neo_ros domain {domain}')
        except OSError:
            holder.close()
            continue
        _held.append(holder)
        return domain
    raise NeoError(f'ROS domain: expected a free one of {DOMAINS[0]} to {DOMAINS[-1]}, all are '
                   'held by other processes; end some of them')
