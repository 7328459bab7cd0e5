"""The rows that the driving experiment writes into its log, one class a table."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["DrivingChainRow", "DrivingLapRow", "DrivingNodeRow", "DrivingTrackRow", "DrivingTransferRow"]


@dataclass(frozen=True, slots=True, kw_only=True)
class DrivingLapRow:
    """One lap. Node times are means over its frames, in seconds.

    Attributes:
        seed: Of the town.
        passed: Whether the judge's rules are met.
        completed: Whether the car came round.
        red_lights_obeyed: Red lights that it stopped at and did not run.
        red_lights_run: Lines that it crossed at red.
        largest_lateral_m: Largest distance from the lane's middle.
        lap_s: Time in the town.
        lane_m: Length of the lap.
        frames: Images.
        lanes_missed: Of them, those without a lane found.
        odometry_error_m: Between where the odometry ends and where the car is.
        odometry_lost: Frames that the odometry could not match.
        camera_s: What drawing an image takes; no node's.
        compensation_s: Node time.
        gaussian_blur_s: Node time.
        lane_planner_s: Node time.
        polyfit_s: Node time.
        red_light_detection_s: Node time, asleep or not.
        green_light_detection_s: Node time, asleep or not.
        visual_odometry_s: Node time.
        lane_control_s: Node time.
    """

    seed: int
    passed: bool
    completed: bool
    red_lights_obeyed: int
    red_lights_run: int
    largest_lateral_m: float
    lap_s: float
    lane_m: float
    frames: int
    lanes_missed: int
    odometry_error_m: float
    odometry_lost: int
    camera_s: float
    compensation_s: float
    gaussian_blur_s: float
    lane_planner_s: float
    polyfit_s: float
    red_light_detection_s: float
    green_light_detection_s: float
    visual_odometry_s: float
    lane_control_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class DrivingChainRow:
    """The chain in one frame: its nodes as measured in software, and how topic A travels by the model.

    Attributes:
        compensation_ns: Node time.
        gaussian_blur_ns: Node time.
        lane_planner_ns: Node time.
        polyfit_ns: Node time.
        lane_control_ns: Node time.
        order: Drawn order of deliveries, as its place in `Chain.orders`.
        place: Which of topic A's readers the blur is in that order, from 1.
        smt_s: From the compensation to the blur over main memory.
        gateway_s: The same through a gateway.
    """

    compensation_ns: int
    gaussian_blur_ns: int
    lane_planner_ns: int
    polyfit_ns: int
    lane_control_ns: int
    order: int
    place: int
    smt_s: float
    gateway_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class DrivingNodeRow:
    """What the graph assumes of one of the chain's nodes.

    Attributes:
        node: Its name.
        in_hardware: Whether it is placed there.
        hardware_s: Its time there; NaN where it is not there.
    """

    node: str
    in_hardware: bool
    hardware_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class DrivingTransferRow:
    """A topic's way along the chain by the memory model, over every order of deliveries.

    Attributes:
        forwarding: Which set of constants: the gateway core stores chunks, or passes them on as they come.
        topic: The topic.
        mapping: One of `MAPPINGS` for topic A; ``as placed`` for the others.
        mean_s: Mean.
        deviation_s: Standard deviation.
        shortest_s: The best order.
        longest_s: The worst.
    """

    forwarding: str
    topic: str
    mapping: str
    mean_s: float
    deviation_s: float
    shortest_s: float
    longest_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class DrivingTrackRow:
    """A moment of the lap that is drawn.

    Attributes:
        t_s: Since its start.
        x_m: The car's true place: east.
        y_m: North.
        yaw_rad: Its heading.
        speed_mps: Its speed.
        left_m: Its distance to the left of the lane's middle.
        red: Of each light, 1 for red and 0 for green.
        held: Whether the lane control is held by a red light.
        lane_seen: Whether the polyfit found a lane.
        lane_offset_m: Of that lane, in the car's frame; NaN without one.
        lane_slope: The same.
        lane_bend_per_m: The same.
        odometry_x_m: Where the odometry believes to be, from the start pose.
        odometry_y_m: The same.
        odometry_yaw_rad: The same.
        command_mps: Commanded speed.
        command_rps: Commanded yaw rate.
        pictured: Whether the log holds the image of that moment.
    """

    t_s: float
    x_m: float
    y_m: float
    yaw_rad: float
    speed_mps: float
    left_m: float
    red: str
    held: bool
    lane_seen: bool
    lane_offset_m: float
    lane_slope: float
    lane_bend_per_m: float
    odometry_x_m: float
    odometry_y_m: float
    odometry_yaw_rad: float
    command_mps: float
    command_rps: float
    pictured: bool
