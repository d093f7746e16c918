"""Limbs are found in trees that nobody named."""

import numpy as np

from crar_drake.motion.joint_topology import Limbs, find_limbs


def tree(text: str) -> tuple[list[str], list[int], np.ndarray]:
    """Of lines "name parent length"."""
    names, parents, lengths = [], [], []
    for line in text.strip().splitlines():
        name, parent, length = line.split()
        parents.append(names.index(parent) if parent != "-" else -1)
        names.append(name)
        lengths.append(float(length))
    return names, parents, np.array(lengths)


def limb(kind: str, parent: str, lengths: list[float]) -> str:
    lines = []
    for side in "ab":
        above = parent
        for i, length in enumerate(lengths):
            lines.append(f"{side}{kind}{i} {above} {length}")
            above = f"{side}{kind}{i}"
        if kind == "arm":
            # Five fingers, each of them shorter than the forearm.
            lines += [f"{side}finger{i} {above} 0.0{i + 4}" for i in range(5)]
            lines += [f"{side}tip{i} {side}finger{i} 0.04" for i in range(5)]
    return "\n".join(lines)


BODY = f"""
reference - 0
hips reference 0.9
{limb("leg", "hips", [0.1, 0.42, 0.41, 0.15, 0.08])}
low hips 0
spine low 0.15
chest spine 0.2
{limb("arm", "chest", [0.12, 0.15, 0.3, 0.26])}
neck chest 0.1
head neck 0.1
top head 0.2
"""


def test_a_body_with_fingers() -> None:
    names, parents, lengths = tree(BODY)
    found = find_limbs(parents, lengths)
    assert isinstance(found, Limbs)
    assert names[found.pelvis] == "hips" and names[found.neck] == "neck"
    assert names[found.head] == "head"
    for side, leg, arm in zip("ab", found.legs, found.arms, strict=True):
        assert [names[i] for i in leg] == [f"{side}leg{i}" for i in (0, 1, 2, 3)]
        assert [names[i] for i in arm] == [f"{side}arm{i}" for i in (1, 2, 3)]


def test_a_long_collar_bone_is_no_upper_arm() -> None:
    """The CMU database's: collar bones 0.19, upper arms 0.24, forearms 0.185 m."""
    text = BODY.replace(limb("arm", "chest", [0.12, 0.15, 0.3, 0.26]), "").replace(
        "neck chest", limb("arm", "chest", [0.01, 0.19, 0.24, 0.185]) + "\nneck chest"
    )
    names, parents, lengths = tree(text.replace("\n\n", "\n"))
    found = find_limbs(parents, lengths)
    assert isinstance(found, Limbs)
    assert [names[i] for i in found.arms[0]] == ["aarm1", "aarm2", "aarm3"]


def test_what_is_no_body_says_what_it_is() -> None:
    for text, words in (
        ("a - 0\nb a 1\nc b 1", "3 joints with 1 ends, and 0 places"),
        (
            "a - 0\n" + limb("leg", "a", [0.1, 0.4, 0.4]),
            "7 joints with 2 ends, and 1 place where",
        ),
    ):
        _, parents, lengths = tree(text)
        found = find_limbs(parents, lengths)
        assert isinstance(found, str) and words in found
