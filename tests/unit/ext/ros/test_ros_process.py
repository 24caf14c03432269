"""The process of ROS: its limit of memory, and the network that it is on."""

from __future__ import annotations

import subprocess
import sys
from xml.etree import ElementTree

from skygcs.ext.ros.dds import MOST_SAMPLE_BYTES, Network, network_config
from skygcs.ext.ros.process import MOST_MEMORY_BYTES

LIMITED = """
import resource
from skygcs.ext.ros.process import MOST_MEMORY_BYTES
from skygcs.ext.ros.rospy_program import limit_memory
limit_memory(MOST_MEMORY_BYTES)
print(*resource.getrlimit(resource.RLIMIT_DATA))
resource.setrlimit(resource.RLIMIT_DATA, (1 << 29, MOST_MEMORY_BYTES))  # the lower one is what counts
limit_memory(MOST_MEMORY_BYTES)
print(*resource.getrlimit(resource.RLIMIT_DATA))
try:
    bytearray(1 << 30)
except MemoryError:
    print("no more")
"""


def test_its_memory_is_limited_and_a_lower_limit_stays() -> None:
    done = subprocess.run([sys.executable, "-c", LIMITED], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines() == [f"{MOST_MEMORY_BYTES} {MOST_MEMORY_BYTES}", f"{1 << 29} {1 << 29}", "no more"]


def test_the_network_is_the_loopback_or_the_peers_and_samples_have_a_limit() -> None:
    here = ElementTree.fromstring(network_config(Network(3, True, ())))
    assert [one.get("address") for one in here.iter("NetworkInterface")] == ["127.0.0.1"]
    assert here.findtext("Domain/Internal/MaxSampleSize") == f"{MOST_SAMPLE_BYTES} B"
    lan = ElementTree.fromstring(network_config(Network(3, False, ("10.0.0.2", "drone.local"))))
    assert [one.get("address") for one in lan.iter("Peer")] == ["127.0.0.1", "10.0.0.2", "drone.local"]
    assert not list(lan.iter("NetworkInterface")) and lan.findtext("Domain/General/AllowMulticast") == "false"
