"""Makes participants of this project reachable from this machine only, if the environment sets LOCALHOST.

ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST keeps a participant from being announced on the network. It still listens on all
interfaces, so a client with the machine's address gets in. config/this_machine.xml binds Fast DDS to loopback and
shared memory. With LOCALHOST, however, rmw_fastrtps adds its own transports to those of a profile, and their sockets on
0.0.0.0 accept datagrams that nothing reads. So with that profile the range is SYSTEM_DEFAULT, with which rmw_fastrtps
adds nothing, and the profile sets what LOCALHOST would: no multicast, and 127.0.0.1 as the initial peer.
"""

from __future__ import annotations

from collections.abc import Mapping, MutableMapping

from rclpy.utilities import get_rmw_implementation_identifier

from fracture_collision.share import share_directory

RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
LOCALHOST, SYSTEM_DEFAULT = "LOCALHOST", "SYSTEM_DEFAULT"
# Where Fast DDS looks for profiles: version 2, then 3.
PROFILES = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE")


def keep_to_this_machine(environment: MutableMapping[str, str]) -> None:
    """Selects the profile, if the range is LOCALHOST, for a participant created with `environment`.

    A user's own profiles and other middleware are left alone.
    """
    has_profiles = any(environment.get(name) for name in PROFILES)
    if environment.get(RANGE) == LOCALHOST and not has_profiles and _is_fast_dds():
        environment[PROFILES[0]], environment[RANGE] = _profile(), SYSTEM_DEFAULT


def as_the_user_has_it(environment: Mapping[str, str]) -> dict[str, str]:
    """`environment` as it was before `keep_to_this_machine`: for child processes."""
    given = dict(environment)
    if given.get(PROFILES[0]) == _profile():
        del given[PROFILES[0]]
        if given.get(RANGE) == SYSTEM_DEFAULT:
            given[RANGE] = LOCALHOST
    return given


def _is_fast_dds() -> bool:
    return get_rmw_implementation_identifier().startswith("rmw_fastrtps")


def _profile() -> str:
    return str(share_directory() / "config" / "this_machine.xml")
