"""Rooms that look alike: no place is believed while another one explains the images as well."""
from dataclasses import replace

from box_room import (
    ABOVE, apart, AWAY, box_memory, EXPANSION, planar, SOURCE, twin_memory, view,
    view_with_picture)
from neo_ros.baking.twin_search import find_twins
from neo_ros.geometry import CameraPose
from neo_ros.memory.alignment_kernels import PhotoLevel
from neo_ros.memory.doubt import Doubt, Hypothesis
from neo_ros.memory.glancing import GlanceFinder
from neo_ros.memory.local_features import find_features
from neo_ros.memory.looking import Looker
from neo_ros.memory.rivals import is_elsewhere
from neo_ros.memory.scene_guide import SceneGuide
from neo_ros.memory.sight import CameraImage, Sight
from neo_ros.memory.thresholds import AmbiguityThresholds, GuideThresholds
from neo_ros.memory.twins import Twins
import numpy as np
import pytest

LIMITS = AmbiguityThresholds()
AT_THE_PICTURE, ASIDE = planar(2.6, 1.9, 0), planar(1.9, 1.7, 180)


def photo_at(pose: CameraPose) -> np.ndarray:
    return view(pose, SOURCE)[0]


@pytest.fixture(scope='module')
def twins() -> SceneGuide:
    return SceneGuide(twin_memory(own_picture=False), EXPANSION)


@pytest.fixture(scope='module')
def with_picture() -> SceneGuide:
    return SceneGuide(twin_memory(own_picture=True), EXPANSION)


def _in_twin(pose: CameraPose, way: tuple[float, float, float] = (AWAY, 0, 0)) -> CameraPose:
    T = pose.T_world_cam.copy()
    T[:3, 3] += way
    return CameraPose(T)


# What is found when a memory is made.
KNOWN = Twins(_in_twin(CameraPose(np.eye(4))).T_world_cam[None],
              np.array([[[0, 0, 0], [3, 3, 3]]]), ASIDE.T_world_cam[None])


def test_equal_rooms_are_ambiguous_however_long_one_looks(twins: SceneGuide) -> None:
    twins.reset()
    for step in range(8):
        assert twins.guide(photo_at(planar(1.9 + 0.05 * step, 1.7, 35 + 5 * step))) is None
        assert twins.ambiguous


def test_a_prior_says_which_of_two_equal_rooms_it_is(twins: SceneGuide) -> None:
    for prior, true in ((planar(2.2, 1.4, 50), planar(1.9, 1.7, 35)),
                        (_in_twin(planar(2.2, 1.4, 50)), _in_twin(planar(1.9, 1.7, 35)))):
        twins.reset()
        assert twins.guide(photo_at(planar(1.9, 1.7, 35))) is None
        found = twins.guide(photo_at(planar(1.9, 1.7, 35)), prior=prior)
        assert found is not None and not twins.ambiguous
        assert apart(found.pose, true)[0] < 0.03
        # From there on it is followed.
        after = twins.guide(photo_at(planar(1.95, 1.7, 37)))
        assert after is not None and apart(after.pose, found.pose)[0] < 0.2


def test_a_prior_says_on_which_of_two_equal_floors_it_is() -> None:
    guide = SceneGuide(twin_memory(own_picture=False, way=(0, 0, ABOVE)), EXPANSION)
    for step in range(3):
        pose = planar(1.9, 1.7, 35 + 40 * step)
        image = photo_at(pose)
        for height in (0.0, ABOVE):
            guide.reset()
            # A click on a map of the floor: the height of the floor, not of the camera.
            found = guide.guide(image, prior=CameraPose.from_planar(
                2.3, 1.3, height, np.radians(55 + 40 * step)))
            assert found is not None and found.found == 'prior'
            assert apart(found.pose, _in_twin(pose, (0, 0, height)))[0] < 0.05
    guide.reset()
    assert guide.guide(image) is None and guide.ambiguous


@pytest.mark.slow
def test_what_tells_the_rooms_apart_is_believed_at_once(with_picture: SceneGuide) -> None:
    for image, true in ((photo_at(AT_THE_PICTURE), AT_THE_PICTURE),
                        (view_with_picture(AT_THE_PICTURE), _in_twin(AT_THE_PICTURE))):
        with_picture.reset()
        found = with_picture.guide(image)
        assert found is not None and apart(found.pose, true)[0] < 0.03


@pytest.mark.slow
def test_a_turn_to_the_picture_resolves_the_doubt(with_picture: SceneGuide) -> None:
    for take, true in ((photo_at, lambda pose: pose), (view_with_picture, _in_twin)):
        with_picture.reset()
        assert with_picture.guide(take(ASIDE)) is None and with_picture.ambiguous
        for degrees in range(172, -1, -8):
            pose = planar(1.9, 1.7, degrees)
            found = with_picture.guide(take(pose))
            if found is not None:
                break
        assert found is not None and not with_picture.ambiguous
        assert apart(found.pose, true(pose))[0] < 0.05
        # It goes on as it turned meanwhile: else a quick camera would be lost again at once.
        expected = CameraPose.nearest(found.pose.T_world_cam @ with_picture._motion)
        assert apart(expected, true(planar(1.9, 1.7, degrees - 8)))[1] < 2


def test_a_place_that_is_shown_poorly_moves_on_with_one_that_is_followed_surely(
        monkeypatch: pytest.MonkeyPatch) -> None:
    memory = twin_memory(own_picture=False)
    looker = Looker(memory, EXPANSION, GuideThresholds())
    doubt = Doubt(looker, GlanceFinder(memory.glances, looker.thresholds))
    image, moved = _image(looker), doubt._moved
    before = planar(1.84, 1.68, 33)
    _open(doubt, [looker.look(image, pose) for pose in (before, _in_twin(before))])

    def drift(image: CameraImage, one: Hypothesis, motion: np.ndarray | None) -> Hypothesis:
        if one.sight.pose.position[0] > AWAY:
            return moved(image, one, motion)
        off = looker.look(image, planar(2.1, 1.7, 45))
        return replace(one, sight=off, motion=before.inverse() @ off.pose.T_world_cam)

    monkeypatch.setattr(doubt, '_moved', drift)
    doubt._follow_all(image, None)
    here, there = doubt._open
    assert apart(here.sight.pose, planar(1.9, 1.7, 35))[0] < 0.03
    assert apart(_in_twin(here.sight.pose), there.sight.pose)[0] < 1e-6


def test_odometry_moves_the_places_that_could_be_it(with_picture: SceneGuide) -> None:
    with_picture.reset()
    assert with_picture.guide(photo_at(ASIDE)) is None
    turned = AT_THE_PICTURE  # in one step: too far to be followed by looks
    found = with_picture.guide(photo_at(turned), motion=ASIDE.inverse() @ turned.T_world_cam)
    assert found is not None and apart(found.pose, turned)[0] < 0.05


def test_a_camera_that_turns_fast_is_followed_at_all_places(twins: SceneGuide) -> None:
    twins.reset()
    yaw = 20
    for step in (0, 4, 8, 12, 16, 19, 22, 23, 23, 23):
        yaw += step
        assert twins.guide(photo_at(planar(1.9, 1.7, yaw))) is None
        assert twins.ambiguous


def test_a_camera_that_was_known_is_not_in_doubt_after_one_bad_image(twins: SceneGuide) -> None:
    twins.reset()
    for step in range(9):
        pose = planar(1.6 + 0.02 * step, 1.5, 20)
        image = np.zeros((64, 64, 3), np.uint8) if step == 6 else photo_at(pose)
        found = twins.guide(image, prior=None if step else pose)
        assert not twins.ambiguous and (found is None) == (step == 6)
        assert found is None or apart(found.pose, pose)[0] < 0.03


def test_a_place_that_the_image_does_not_fit_any_more_is_dropped(twins: SceneGuide) -> None:
    twins.reset()
    assert twins.guide(photo_at(ASIDE)) is None and twins.ambiguous
    noise = np.random.default_rng(0).integers(0, 256, (64, 64, 3), np.uint8)
    assert twins.guide(noise) is None and not twins.ambiguous


@pytest.mark.slow
def test_a_single_room_is_never_ambiguous() -> None:
    guide = SceneGuide(box_memory(), EXPANSION)
    for yaw in range(0, 360, 40):
        guide.reset()
        assert guide.guide(photo_at(planar(1.9, 1.7, yaw))) is not None and not guide.ambiguous


@pytest.mark.parametrize('other, elsewhere', [
    (planar(2.2, 1.7, 40), False), (planar(3.2, 1.7, 35), True), (planar(1.9, 1.7, 60), True)],
    ids=['near', 'a metre off', 'turned'])
def test_what_is_elsewhere(other: CameraPose, elsewhere: bool) -> None:
    assert is_elsewhere(planar(1.9, 1.7, 35), other, LIMITS) == elsewhere


def test_rivals_are_places_elsewhere_that_look_about_as_alike(twins: SceneGuide) -> None:
    pose = planar(1.9, 1.7, 35)
    finder, photo = twins._places.glances, photo_at(pose)
    likeness = dict(zip(map(bytes, finder.poses), finder._likeness(
        photo, np.arange(len(finder.poses)))))
    most = max(likeness.values())
    rivals = finder.find_rivals(photo, pose, LIMITS)
    assert all(is_elsewhere(rival, pose, LIMITS) for rival in rivals)
    assert not is_elsewhere(rivals[0], _in_twin(pose), LIMITS)
    assert min(likeness[bytes(rival.T_world_cam)] for rival in rivals) >= most - LIMITS.less_alike
    strict = replace(LIMITS, less_alike=0.02)
    assert len(finder.find_rivals(photo, pose, strict)) < len(rivals)
    assert len(finder.find_rivals(photo, pose, replace(LIMITS, starts=1))) == 1
    assert not finder.find_rivals(photo, pose, replace(LIMITS, starts=0))


@pytest.mark.slow
@pytest.mark.parametrize('true, told', [(AT_THE_PICTURE, True), (ASIDE, False)])
def test_a_place_that_was_found_a_little_off_does_not_lose_to_its_twin(
        true: CameraPose, told: bool) -> None:
    """Landmarks are believed before alignment is: the twin, which is aligned, looks better."""
    memory = twin_memory(own_picture=True)
    memory.twins = find_twins(memory, EXPANSION)
    looker = Looker(memory, EXPANSION, GuideThresholds())
    doubt = Doubt(looker, GlanceFinder(memory.glances, looker.thresholds), memory.twins)
    pixels = photo_at(true)
    image = CameraImage(pixels, looker.aligner.photo(pixels), find_features)
    for off in (0.08, 0.15, 0.2):
        near = planar(true.position[0] + off, true.position[1] + off,
                      np.degrees(np.arctan2(*true.forward[1::-1])) + 20 * off)
        found = replace(looker.look(image, near), believed=True, located=True)
        settled = doubt.settle(image, None, found, [])
        assert doubt.is_open == (not told)
        assert settled is None if not told else (
            settled is not None and apart(settled.pose, true)[0] < 0.05)


def test_a_search_that_ended_in_a_twin_goes_on_to_where_the_camera_is(
        with_picture: SceneGuide) -> None:
    looker = with_picture._looker
    for take, true, way in ((photo_at, AT_THE_PICTURE, (AWAY, 0, 0)),
                            (view_with_picture, _in_twin(AT_THE_PICTURE), (-AWAY, 0, 0))):
        doubt = Doubt(looker, with_picture._places.glances, KNOWN)
        pixels = take(AT_THE_PICTURE)
        image = CameraImage(pixels, looker.aligner.photo(pixels), find_features)
        found = looker.glimpse(image, _in_twin(true, way), searched=True)
        settled = doubt.settle(image, None, replace(found, believed=False), [])
        assert settled is not None and apart(settled.pose, true)[0] < 0.03
        # What is nowhere so well stays where it was found, and is not believed.
        other = replace(looker.look(image, true), believed=False)
        settled = doubt.settle(image, None, other, [])
        assert settled is not None and settled.pose is other.pose and not settled.believed


def test_a_known_twin_that_is_aligned_badly_stays_where_it_is(
        twins: SceneGuide, monkeypatch: pytest.MonkeyPatch) -> None:
    looker, pose = twins._looker, planar(1.9, 1.7, 35)
    image, there = _image(looker), _in_twin(pose)
    doubt = Doubt(looker, twins._places.glances, KNOWN)

    def drifting(photo: object, start: CameraPose, *_: object, **__: object) -> CameraPose:
        return planar(start.position[0], start.position[1] + 0.15, 38)

    monkeypatch.setattr(looker.aligner, 'align', drifting)
    rival, = doubt._rivals.find(image, looker.look(image, pose), [])
    assert max(apart(rival.pose, there)) < 1e-6 and rival.believed
    # A start that leads there, too, must not take its place: it ends where the alignment fails.
    rival, = doubt._rivals.find(image, looker.look(image, pose), [planar(1.95 + AWAY, 1.7, 35)])
    assert max(apart(rival.pose, there)) < 1e-6
    # What the memory shows too poorly to be believed could be it; what it shows otherwise not.
    look = looker.glimpse
    for agrees, rivals in ((0.8, 1), (0.7, 0)):
        monkeypatch.setattr(looker, 'glimpse', lambda *asked, agrees=agrees: replace(
            look(*asked), agreement=agrees, believed=False))
        found = replace(look(image, pose), agreement=0.95)
        assert len(doubt._rivals.find(image, found, [])) == rivals


def test_what_leads_to_a_known_twin_is_not_aligned(twins: SceneGuide,
                                                   monkeypatch: pytest.MonkeyPatch) -> None:
    """On a floor of 50 rooms that takes a fifth of a search."""
    looker, pose = twins._looker, planar(1.9, 1.7, 35)
    image, aligned = _image(looker), list[CameraPose]()
    align = looker.coarse_aligner.align

    def align_and_tell(photo: list[PhotoLevel], start: CameraPose, rounds: int) -> CameraPose:
        aligned.append(start)
        return align(photo, start, rounds)

    monkeypatch.setattr(looker.coarse_aligner, 'align', align_and_tell)
    beside, behind = planar(2.4 + AWAY, 1.2, 25), planar(1.9 + AWAY, 1.7, 80)
    rivals = Doubt(looker, twins._places.glances, KNOWN)._rivals
    rival, = rivals.find(image, looker.look(image, pose), [beside, behind])
    assert max(apart(rival.pose, _in_twin(pose))) < 0.1 and aligned == [behind]


def test_places_that_are_followed_stay_exact_twins(twins: SceneGuide,
                                                   monkeypatch: pytest.MonkeyPatch) -> None:
    """Else chance, image after image, speaks against the one that is aligned a little worse."""
    looker, pose = twins._looker, planar(1.9, 1.7, 35)
    image, there = _image(looker), _in_twin(pose)
    doubt = Doubt(looker, twins._places.glances, KNOWN)
    _open(doubt, [looker.look(image, one) for one in (pose, there)])
    aligned = {0: planar(2.0, 1.7, 37), 1: there}
    monkeypatch.setattr(doubt, '_moved', lambda image, one, motion: replace(one, sight=looker.look(
        image, aligned[int(one.sight.pose.position[0] > AWAY)])))
    doubt._follow_all(image, np.eye(4))
    assert [max(apart(one.sight.pose, true)) < 1e-6
            for one, true in zip(doubt._open, (pose, there))] == [True, True]


def test_what_was_refuted_stays_where_it_is_whichever_place_is_left(
        monkeypatch: pytest.MonkeyPatch) -> None:
    """Three rooms in a row: the third is refuted first, then the first, to which it was told."""
    memory = box_memory()
    looker = Looker(memory, EXPANSION, GuideThresholds())
    doubt = Doubt(looker, GlanceFinder(memory.glances, looker.thresholds))
    rooms = [looker.look(_image(looker), planar(x, 1.7, 35)) for x in (1.9, 6.9, 11.9, 16.9)]
    _open(doubt, rooms[:3])
    said = iter([_evidence([0.0, 0.01, 0.2]), _evidence([0.2, 0.0]), np.zeros((2, 2))])
    monkeypatch.setattr(doubt, '_follow_all', lambda *_: None)
    monkeypatch.setattr(doubt, '_is_worth_asking', lambda _: True)
    monkeypatch.setattr(doubt, '_ask', lambda *_: next(said))
    monkeypatch.setattr(doubt._rivals, 'starts', lambda *_: [])
    monkeypatch.setattr(doubt._rivals, 'find', lambda *_: [rooms[2], rooms[3]])
    assert doubt.follow(_image(looker), None) is None
    # The fourth, which nothing has refuted, could be it still.
    assert doubt.follow(_image(looker), None) is None
    assert [one.sight for one in doubt._open] == [rooms[1], rooms[3]]


@pytest.mark.parametrize('said, left', [
    # One image that speaks against a place for which those before it spoke does not refute it.
    ([-0.03, -0.02, 0.085], [0, 1]),
    # Many that say a little do, and a picture at once.
    ([0.03, 0.03, 0.03], [1]), ([0.0, 0.0, 0.0, 0.07], [1]), ([-0.07], [0]),
    # What is said now and then is chance, however long one walks.
    (20 * [0.008, -0.001], [0, 1])])
def test_images_speak_together(twins: SceneGuide, monkeypatch: pytest.MonkeyPatch,
                               said: list[float], left: list[int]) -> None:
    looker, doubt = twins._looker, Doubt(twins._looker, twins._places.glances)
    image, pose = _image(looker), planar(1.9, 1.7, 35)
    sights = [looker.look(image, one) for one in (pose, _in_twin(pose))]
    _open(doubt, sights)
    monkeypatch.setattr(doubt, '_follow_all', lambda *_: None)
    monkeypatch.setattr(doubt, '_is_worth_asking', lambda _: True)
    monkeypatch.setattr(doubt._rivals, 'starts', lambda *_: [])
    for share in said:
        monkeypatch.setattr(doubt, '_ask', lambda _, asked, share=share: _evidence(
            [share, 0.0][:len(asked)]))
        found = doubt.follow(image, None)
    if len(left) == 2:
        assert found is None and doubt.is_open
    else:
        assert found is not None and found.sight.pose is sights[left[0]].pose


def test_an_image_is_asked_where_the_camera_has_moved_and_agrees(twins: SceneGuide) -> None:
    looker, doubt = twins._looker, Doubt(twins._looker, twins._places.glances)
    sight = looker.look(_image(looker), planar(1.9, 1.7, 35))
    for asked, worth in ((planar(1.9, 1.65, 35), False), (planar(1.9, 1.55, 35), True),
                         (planar(1.9, 1.7, 43), True)):
        assert doubt._is_worth_asking(Hypothesis(sight, np.eye(4), asked)) == worth
        hidden = replace(sight, agreement=0.8)
        assert not doubt._is_worth_asking(Hypothesis(hidden, np.eye(4), asked))


def test_places_that_no_image_agrees_with_are_searched_for_anew(twins: SceneGuide) -> None:
    twins.reset()
    assert twins.guide(photo_at(ASIDE)) is None and twins.ambiguous
    for one in twins._doubt._open:
        one.sight = replace(one.sight, agreement=0.8)
    assert twins._doubt.is_lost
    # The camera is somewhere else; what was followed would never be found again.
    twins._doubt.follow = lambda *_: None  # type: ignore[method-assign]
    for _ in range(twins.thresholds.search_every):
        assert twins.guide(photo_at(planar(1.9, 1.7, 35))) is None
    del twins._doubt.follow
    assert twins.ambiguous and not twins._doubt.is_lost
    assert min(apart(one.sight.pose, planar(1.9, 1.7, 35))[0] for one in twins._doubt._open) < 0.05


def test_somebody_before_the_camera_does_not_end_the_doubt() -> None:
    """Landmarks are believed at half the agreement: a twin must not need more."""
    memory = twin_memory(own_picture=False)
    looker = Looker(memory, EXPANSION, GuideThresholds())
    doubt = Doubt(looker, GlanceFinder(memory.glances, looker.thresholds))
    pixels = photo_at(ASIDE).copy()
    pixels[24:, 24:40] = (40, 60, 90)
    image = CameraImage(pixels, looker.aligner.photo(pixels), find_features)
    found = replace(looker.look(image, ASIDE), believed=True, located=True)
    assert 0.5 < found.agreement < 0.8
    assert doubt.settle(image, None, found, [_in_twin(ASIDE)]) is None and doubt.is_open


def test_one_place_that_was_found_twice_is_no_doubt(monkeypatch: pytest.MonkeyPatch) -> None:
    """A twin leads back to where exactly the camera is."""
    memory = box_memory()
    looker = Looker(memory, EXPANSION, GuideThresholds())
    doubt, image = Doubt(looker, GlanceFinder(memory.glances, looker.thresholds)), _image(looker)
    found, twin, exact = (replace(looker.look(image, planar(x, 1.7, 35)), believed=True)
                          for x in (2.0, 6.9, 1.9))
    rivals = iter([[twin], [exact], []])
    said = iter(map(_evidence, [[0.05, 0.0], [0.02, 0.2, 0.0], [0.02, 0.2, 0.0]]))
    monkeypatch.setattr(doubt._rivals, 'find', lambda *_: next(rivals))
    monkeypatch.setattr(doubt, '_ask', lambda *_: next(said))
    assert doubt.settle(image, None, found, []) is exact and not doubt.is_open


def test_rivals_are_drawn_in_the_light_of_now(twins: SceneGuide) -> None:
    renderers = (twins.renderer, twins._looker.coarse_aligner.renderer)
    assert [one.light for one in renderers] == [twins.light] * 2


def _open(doubt: Doubt, sights: list[Sight]) -> None:
    doubt._open = [Hypothesis(sight, np.eye(4), sight.pose) for sight in sights]
    doubt._evidence = np.zeros((len(sights), len(sights)))


def _evidence(against: list[float]) -> np.ndarray:
    """Return evidence, antisymmetric (N, N), where so much speaks against each for the best."""
    return np.subtract.outer(against, against)


def _image(looker: Looker) -> CameraImage:
    pixels = photo_at(planar(1.9, 1.7, 35))
    return CameraImage(pixels, looker.aligner.photo(pixels), find_features)
