"""Which joint of the body a name in a file means, whoever gave it, or the user says.

A name is cut into words (at blanks, signs, digits and capitals), its side is taken
out, and the words left are looked up. What one maker calls a shoulder is another's
collar bone, so names are weighed against the others of their side.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, make_dataclass

from crar_drake.errors import MotionError, nearest
from crar_drake.motion.performer import JOINTS, SIDES
from crar_drake.yaml_files import load_yaml, read_text

_SIDE_WORDS = {"left": ("left", "lft", "lt", "l"), "right": ("right", "rgt", "rt", "r")}

# A joint with one of these words in its name is none of the body's own.
_OTHERS = frozenset(
    "twist roll ik fk pole target helper end nub tip site finger fingers index middle "
    "mid ring pinky pinkie little palm eye jaw tongue hair ear heel effector aim ctrl "
    "control bigtoe prop meta metacarpal carpal inhand breast pocket weapon".split()
)

# Those of a bone's end. A foot's, unlike others, counts: where there are no toes.
_ENDS = frozenset("end nub tip site".split())

# Part of the body: what it is called, words glued together.
_WORDS = {
    "toe": "toe toes toebase ball forefoot toejoint",
    "ankle": "ankle anklejoint talus",
    "foot": "foot feet",
    "knee": "knee lowerleg lowleg loleg lleg shin calf tibia shank leglower crus "
    "kneejoint fleg",
    "thigh": "upleg upperleg uleg thigh femur legupper legup hip hips",
    "hip joint": "hipjoint",
    "leg": "leg",
    "elbow": "forearm forarm elbow lowerarm lowarm loarm farm radius armlower ulna "
    "elbowjoint",
    "wrist": "wrist wristjoint",
    "hand": "hand",
    "upper arm": "upperarm uparm uarm humerus armupper",
    "arm": "arm",
    "collar": "collar clavicle clav scapula collarbone shoulderblade innershoulder",
    "shoulder": "shoulder shldr shoulderjoint",
    "thumb": "thumb",
    "pelvis": "hips hip pelvis",
    "neck": "neck lowerneck neckbase cervical",
    "head": "head skull",
}
_UNSIDED = ("pelvis", "neck", "head")
_PART_OF = {
    sided: {
        word: part
        for part, words in _WORDS.items()
        if (part not in _UNSIDED) == sided
        for word in words.split()
    }
    for sided in (True, False)
}

_MOST_WORDS = 3  # that are glued together


@dataclass(frozen=True)
class Meaning:
    """What a name says."""

    side: str  # "left", "right" or ""
    part: str  # a key of the table of words, or "end of the foot"


def words_of(name: str) -> list[str]:
    """The words of a joint's name, in lower case, without namespace and digits."""
    name = name.rpartition(":")[2] or name
    found = re.findall(r"[A-Z]+(?=[A-Z][a-z])|[A-Z]?[a-z]+|[A-Z]+", name)
    return [word.lower() for word in found]


def meaning(name: str) -> Meaning | None:
    """What a joint's name means; None if it is none of the body's main joints."""
    words = words_of(name)
    side, words = _take_side(words)
    others = _OTHERS.intersection(words)
    if others:
        foot = side and others <= _ENDS and set(words) - others == {"foot"}
        return Meaning(side, "end of the foot") if foot else None
    table = _PART_OF[bool(side)]
    for count in range(min(_MOST_WORDS, len(words)), 0, -1):
        for start in range(len(words) - count, -1, -1):
            part = table.get("".join(words[start : start + count]))
            if part is not None:
                return Meaning(side, part)
    return None


def _take_side(words: list[str]) -> tuple[str, list[str]]:
    """The side, and the words without it."""
    for side in SIDES:
        for word in _SIDE_WORDS[side]:
            if word in words:
                rest = list(words)
                rest.remove(word)
                return side, rest
    for i, word in enumerate(words):
        for side in SIDES:
            for spelled in (side, side[0]):
                rest = word.removeprefix(spelled)
                if rest == word or not rest:
                    continue
                glued = rest + "".join(words[i + 1 : i + 2])  # LUArm: "lu", "arm"
                known = rest in _PART_OF[True] or rest in _OTHERS
                if known or glued in _PART_OF[True]:
                    return side, [*words[:i], rest, *words[i + 1 :]]
            # "armleft", "handr" in small letters throughout
            for spelled in (side, side[0]):
                rest = word.removesuffix(spelled)
                if rest != word and len(rest) > 2 and rest in _PART_OF[True]:
                    return side, [*words[:i], rest, *words[i + 1 :]]
    return "", words


def joints_by_name(names: Sequence[str]) -> dict[str, int]:
    """Joints (of `performer.JOINTS`, and "left_thumb", ...) to the index of a name.

    Of several names that mean the same the first counts. Parents come first; "" is an
    end site.
    """
    found: dict[tuple[str, str], int] = {}
    for index, name in enumerate(names):
        what = meaning(name) if name else None
        if what is not None:
            found.setdefault((what.side, what.part), index)
    result = {
        part: found["", part]
        for part in ("pelvis", "neck", "head")
        if ("", part) in found
    }
    for side in SIDES:
        parts = {part: i for (s, part), i in found.items() if s == side}
        for joint, index in _limbs(parts).items():
            result[f"{side}_{joint}"] = index
    return result


def _limbs(parts: Mapping[str, int]) -> dict[str, int]:
    """Joints of one side, from what names of that side mean."""

    def first(*kinds: str) -> int | None:
        return next((parts[kind] for kind in kinds if kind in parts), None)

    # A "leg" below a thigh is the shank; without a thigh it is the thigh itself.
    thigh = first("thigh", *(() if "knee" not in parts else ("leg",)), "hip joint")
    knee = first("knee", *(("leg",) if "thigh" in parts else ()))
    if thigh is None and "leg" in parts:
        thigh = parts["leg"]
    # An "arm" is the upper arm. A "shoulder" is the collar bone if there is an arm.
    shoulder = first("upper arm", "arm", "shoulder")
    chosen = {
        "hip": thigh,
        "knee": knee,
        "ankle": first("ankle", "foot"),
        "toe": first(
            "toe", *(("foot",) if "ankle" in parts else ()), "end of the foot"
        ),
        "shoulder": shoulder,
        "elbow": first("elbow"),
        "wrist": first("wrist", "hand"),
        "thumb": first("thumb"),
    }
    return {joint: index for joint, index in chosen.items() if index is not None}


# Each joint, and the thumbs, to the file's name for it; "" keeps the match.
JointFile = make_dataclass(
    "JointFile", [(joint, str, "") for joint in (*JOINTS, "left_thumb", "right_thumb")]
)


def load_joint_file(path: str, names: Sequence[str]) -> dict[str, int]:
    """Joint to the index of the name that a YAML file gives it, of those of the motion.

    Raises:
        MotionError: the file cannot be read, or names a joint that there is not.
    """
    parsed = load_yaml(
        read_text(path, MotionError),
        JointFile,
        path,
        MotionError,
        manual="docs/guides/your-motion.md",
    )
    chosen = {}
    for joint, name in asdict(parsed).items():
        if not name:
            continue
        if name not in names:
            known = [known for known in names if known]
            raise MotionError(
                f"{path}: {joint}: the motion has no {name!r}"
                f"{nearest(name, known)}; it has {', '.join(known)}"
            )
        chosen[joint] = list(names).index(name)
    return chosen
