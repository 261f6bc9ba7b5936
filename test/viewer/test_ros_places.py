"""Where the camera is, from a ROS graph, and what the map and looks make of it."""
import asyncio
import json

import aiohttp
from box_room import EXPANSION, planar, view, write_box_model
from neo_ros.messages import image_fields
from neo_ros.messages.scene_outputs import POSE, pose_message
from neo_ros.node.message_types import find_message_class, make_message
import numpy as np
from ros_graph import ros_graph, WAIT_S
from sensor_msgs.msg import Image
from std_msgs.msg import Header
from viewer_server import split

HERE = planar(1.9, 1.7, 30)
LOOK = {'yaw': 2.0, 'pitch': 0.0, 'hfov': 1.2, 'width': 160, 'height': 120}


async def look(url, send):
    """Return the map, then place and look, while `send` feeds the graph."""
    url = url.rstrip('/')
    async with aiohttp.ClientSession() as session:
        plan = await (await session.get(f'{url}/map')).json()
        # Pictures are asked for, or nothing is subscribed to.
        async with (session.ws_connect(f'{url}/stream', origin=url, max_msg_size=0) as stream,
                    session.ws_connect(f'{url}/around', origin=url, max_msg_size=0) as around):
            await stream.send_str(json.dumps({'paused': False}))
            place = {}
            for _ in range(round(WAIT_S / 0.1)):
                send()
                try:
                    message = await asyncio.wait_for(around.receive(), 0.1)
                except TimeoutError:
                    continue
                if message.type is aiohttp.WSMsgType.TEXT:
                    place = json.loads(message.data)
                    await around.send_json({'got': place['seq'], 'look': LOOK})
                    continue
                return plan, place, split(message.data)[0]
    raise AssertionError('no look came')


def test_poses_and_pictures_of_the_graph_lead_to_looks(tmp_path):
    model = write_box_model(tmp_path)
    with ros_graph() as graph:
        process = graph.start('-m', 'neo_ros.viewer.main', '--ros-args', '-r', '__ns:=/robot',
                              '-p', 'port:=0', '-p', f'model:={model}')
        assert process.stdout is not None
        url = process.stdout.readline().split()[-1]
        pictures = graph.node.create_publisher(Image, '/robot/wide/image', 10)
        poses = graph.node.create_publisher(find_message_class(POSE), '/robot/wide/pose', 10)
        fields = image_fields(view(HERE, EXPANSION.target)[0])

        def send():
            header = Header(stamp=graph.node.get_clock().now().to_msg(), frame_id='camera')
            pictures.publish(make_message('sensor_msgs/msg/Image', header=header, **fields))
            poses.publish(pose_message(make_message, header, HERE, np.eye(6), 'map'))
            graph.spin_for(0.02)

        plan, place, drawn = asyncio.run(look(url, send))
        assert plan['metric'] is True and plan['width'] > 50
        assert np.allclose(place['position'], HERE.position, atol=1e-3)
        assert np.allclose(place['forward'], HERE.forward, atol=1e-3)
        assert drawn['type'] == 'look' and drawn['yaw'] == 2.0
        # With nobody left, nobody asks where the camera is.
        graph.spin_until(lambda: graph.node.count_subscribers('/robot/wide/pose') == 0)
        process.terminate()
        assert process.wait(WAIT_S) == 0
