"""Let Fast DDS carry large images."""
from collections.abc import MutableMapping
import os

from neo_ros.machine.files import share_dir

VARIABLE = 'FASTRTPS_DEFAULT_PROFILES_FILE'
# Whoever set one of these has chosen a profile already.
USER_CHOICES = (VARIABLE, 'FASTDDS_DEFAULT_PROFILES_FILE')


def use_large_image_profile(environment: MutableMapping[str, str] = os.environ) -> bool:
    """
    Point Fast DDS to the shipped profile, unless the user has set one; return whether it did.

    Must come before `rclpy.init`. With its defaults Fast DDS loses most best-effort messages
    above 0.5 MB; only the publisher's side matters. Other middlewares ignore the variable.
    """
    if any(environment.get(name) for name in USER_CHOICES):
        return False
    environment[VARIABLE] = str(share_dir() / 'config' / 'fastdds_large_images.xml')
    return True
