"""Whom participants of this project can be reached by: this machine alone, where the environment says LOCALHOST.

ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST keeps a participant from being announced on the network. It still listens on all
interfaces, and who knows the machine's address gets in. config/this_machine.xml binds Fast DDS to loopback and shared
memory. With LOCALHOST, though, rmw_fastrtps adds transports of its own to those of a profile, whose sockets on 0.0.0.0
take datagrams that nothing reads. So with that profile the range is SYSTEM_DEFAULT, with which rmw_fastrtps adds
nothing, and the profile says what LOCALHOST would: no multicast, and 127.0.0.1 as the peer to ask.
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
    """Chooses the profile, where the range is LOCALHOST, for a participant that is made with `environment`. Profiles of
    the user's and other middleware are left alone.
    """
    has_profiles = any(environment.get(name) for name in PROFILES)
    if environment.get(RANGE) == LOCALHOST and not has_profiles and _is_fast_dds():
        environment[PROFILES[0]], environment[RANGE] = _profile(), SYSTEM_DEFAULT


def as_the_user_has_it(environment: Mapping[str, str]) -> dict[str, str]:
    """`environment` as it was before `keep_to_this_machine`: for processes that are started."""
    given = dict(environment)
    if given.get(PROFILES[0]) == _profile():
        del given[PROFILES[0]]
        if given.get(RANGE) == SYSTEM_DEFAULT:
            given[RANGE] = LOCALHOST
    return given


def has_known_transports(environment: Mapping[str, str]) -> bool:
    """Whether a participant made with `environment` has Fast DDS's default transports or those of our own profile. What
    the user's profiles choose, or other middleware, is not ours to judge.
    """
    profiles = {environment.get(name, "") for name in PROFILES} - {""}
    if not _is_fast_dds() or profiles - {_profile()}:
        return False
    return bool(profiles) or environment.get("FASTDDS_BUILTIN_TRANSPORTS", "DEFAULT") == "DEFAULT"


def _is_fast_dds() -> bool:
    return get_rmw_implementation_identifier().startswith("rmw_fastrtps")


def _profile() -> str:
    return str(share_directory() / "config" / "this_machine.xml")
