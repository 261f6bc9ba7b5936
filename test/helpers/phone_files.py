"""The small posed capture of `capture_files` as data sets and phones write it."""
import json
from pathlib import Path
import zipfile

from capture_files import CAMERA, Photos, START_NS, STEP_NS, write_image
from neo_ros.geometry.camera_pose import quaternion_from_rotation
import numpy as np
import yaml

# World with z up to ARKit's, with y up.
Y_UP = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])


def stamp(index: int) -> int:
    return START_NS + index * STEP_NS


def pose_words(T: np.ndarray, scalar_first: bool = False) -> list[float]:
    """Return x y z and the quaternion."""
    x, y, z, w = map(float, quaternion_from_rotation(T[:3, :3]))
    return [*map(float, T[:3, 3]), *((w, x, y, z) if scalar_first else (x, y, z, w))]


def write_camera_info(path: Path) -> Path:
    """Write the camera as camera_calibration does, pixels counted from 0."""
    matrix = CAMERA.matrix
    matrix[:2, 2] -= 0.5
    path.write_text(yaml.safe_dump({
        'image_width': CAMERA.width, 'image_height': CAMERA.height,
        'distortion_model': 'plumb_bob',
        'camera_matrix': {'rows': 3, 'cols': 3, 'data': matrix.ravel().tolist()},
        'distortion_coefficients': {'rows': 1, 'cols': 5, 'data': [0.0] * 5}}))
    return path


def write_tum(folder: Path, photos: Photos, late_ns: int = 0) -> Path:
    """Write a folder whose poses are stamped `late_ns` after the images."""
    names = ['# timestamp filename']
    poses = ['# timestamp tx ty tz qx qy qz qw']
    for index, (image, pose) in enumerate(zip(photos.images, photos.poses)):
        name = f'rgb/{stamp(index) / 1e9:.6f}.png'
        write_image(folder / name, image)
        names.append(f'{stamp(index) / 1e9:.6f} {name}')
        words = ' '.join(map(repr, pose_words(pose.T_world_cam)))
        late = stamp(index) + late_ns
        poses.append(f'{late // 10**9}.{late % 10**9:09d} {words}')
    (folder / 'rgb.txt').write_text('\n'.join(names))
    (folder / 'groundtruth.txt').write_text('\n'.join(poses))
    return folder


def write_euroc(folder: Path, photos: Photos, T_body_cam: np.ndarray = np.eye(4)) -> Path:
    """Write mav0/ with poses of a body that carries the camera at (4, 4) T_body_cam."""
    cam0, truth = folder / 'mav0/cam0', folder / 'mav0/state_groundtruth_estimate0'
    images, poses = ['#timestamp [ns],filename'], ['#timestamp, p_RS_R_x [m], ...']
    for index, (image, pose) in enumerate(zip(photos.images, photos.poses)):
        name = f'{stamp(index)}.png'
        write_image(cam0 / 'data' / name, image)
        images.append(f'{stamp(index)},{name}')
        T_world_body = pose.T_world_cam @ np.linalg.inv(T_body_cam)
        words = pose_words(T_world_body, scalar_first=True)
        poses.append(','.join(map(repr, [stamp(index), *words, 0.0, 0.0, 0.0])))
    (cam0 / 'data.csv').write_text('\n'.join(images))
    (cam0 / 'sensor.yaml').write_text('%YAML:1.0\n' + yaml.safe_dump({
        'sensor_type': 'camera', 'camera_model': 'pinhole',
        'T_BS': {'cols': 4, 'rows': 4, 'data': T_body_cam.ravel().tolist()},
        'resolution': [CAMERA.width, CAMERA.height],
        'intrinsics': [CAMERA.fx, CAMERA.fy, CAMERA.cx - 0.5, CAMERA.cy - 0.5],
        'distortion_model': 'radial-tangential', 'distortion_coefficients': [0.0] * 4}))
    truth.mkdir()
    (truth / 'data.csv').write_text('\n'.join(poses))
    return folder


def record3d_metadata(photos: Photos) -> dict[str, object]:
    poses = []
    for pose in photos.poses:
        words = pose_words(Y_UP @ pose.to_opengl())
        poses.append([*words[3:], *words[:3]])
    return {'w': CAMERA.width, 'h': CAMERA.height, 'fps': 30, 'poses': poses,
            'K': CAMERA.matrix.T.ravel().tolist()}


def write_record3d(folder: Path, photos: Photos) -> Path:
    for index, image in enumerate(photos.images):
        write_image(folder / f'rgb/{index}.png', image)
    (folder / 'metadata.json').write_text(json.dumps(record3d_metadata(photos)))
    return folder


def write_r3d(folder: Path, photos: Photos) -> Path:
    folder.mkdir(parents=True)
    with zipfile.ZipFile(folder / 'walk.r3d', 'w') as archive:
        archive.writestr('metadata', json.dumps(record3d_metadata(photos)))
        for index, image in enumerate(photos.images):
            archive.write(write_image(folder / 'one.png', image), f'rgbd/{index}.png')
    return folder / 'walk.r3d'


def write_polycam(folder: Path, photos: Photos, kind: str = '') -> Path:
    keyframes = folder / 'keyframes'
    (keyframes / f'{kind}cameras').mkdir(parents=True)
    for index, (image, pose) in enumerate(zip(photos.images, photos.poses)):
        write_image(keyframes / f'{kind}images/{100 + index}.png', image)
        T = Y_UP @ pose.to_opengl()
        (keyframes / f'{kind}cameras/{100 + index}.json').write_text(json.dumps({
            'fx': CAMERA.fx, 'fy': CAMERA.fy, 'cx': CAMERA.cx, 'cy': CAMERA.cy,
            'width': CAMERA.width, 'height': CAMERA.height, 'blur_score': 100,
            **{f't_{row}{column}': float(T[row, column]) for row in range(3)
               for column in range(4)}}))
    (folder / 'mesh_info.json').write_text('{}')
    write_image(folder / 'thumbnail.jpg', photos.images[0])
    return folder
