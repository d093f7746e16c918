"""What is at hand: the robots, motions and scenarios that a name stands for."""


def print_what_is_at_hand() -> None:
    """Prints them, each with what it is."""
    from crar_drake.motion.catalogue import available_trials, builtin_names, load_clip
    from crar_drake.resources import data_folder
    from crar_drake.robot.description import import_file, imported_names, robot_names
    from crar_drake.simulation.scenario import load_scenario, scenario_names

    def duration(motion: str) -> str:
        clip = load_clip(motion)
        return f"{clip.duration:.1f} s at {clip.frame_rate:g} Hz"

    def about(robot: str) -> str:
        """What follows the name in the first line of the robot's README."""
        readme = data_folder("models") / robot / "README.md"
        if not readme.is_file():
            return ""
        with readme.open(encoding="utf-8") as lines:
            return lines.readline().partition(":")[2].strip()

    imported = imported_names()
    robots = {name: "imported" for name in imported}
    robots |= {name: about(name) for name in robot_names()}
    for name in robot_names():
        if import_file(name) is not None and name not in imported:
            robots[name] += f"; first: crar-drake import-robot {name}"
    motions = {name: duration(name) for name in builtin_names()}
    motions |= {name: str(file) for name, file in available_trials().items()}
    scenarios = {name: load_scenario(name).description for name in scenario_names()}
    for title, entries in (
        ("Robots, which a scenario names (crar-drake import-robot adds more)", robots),
        ("Motions, for run --motion (and any file of a person's motion)", motions),
        ("Scenarios, for crar-drake run", scenarios),
    ):
        print(title)
        width = max([20, *(len(name) for name in entries)])
        for name, text in entries.items():
            print(f"  {name:<{width}}  {text}".rstrip())
