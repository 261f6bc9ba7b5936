"""Read, write and replay rosbag2 bags without a ROS graph."""
from neo_ros.bags.damage import Damage
from neo_ros.bags.demo_bag import write_demo_bag
from neo_ros.bags.reading import BagMessage, BagReader
from neo_ros.bags.replay import replay, ReplayResult, Section
from neo_ros.bags.topic import BagTopic
from neo_ros.bags.writing import BagWriter

__all__ = ['BagMessage', 'BagReader', 'BagTopic', 'BagWriter', 'Damage', 'ReplayResult',
           'Section', 'replay', 'write_demo_bag']
