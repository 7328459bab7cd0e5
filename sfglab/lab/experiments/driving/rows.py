"""The rows that the driving experiment writes into its log, one class a table."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class DrivingLapRow:
    """One lap. Node times are means over its frames, in seconds."""

    seed: int  #: Of the town.
    passed: bool  #: Whether the judge's rules are met.
    completed: bool  #: Whether the car came round.
    red_lights_obeyed: int  #: Red lights that it stopped at and did not run.
    red_lights_run: int  #: Lines that it crossed at red.
    largest_lateral_m: float  #: Largest distance from the lane's middle.
    lap_s: float  #: Time in the town.
    lane_m: float  #: Length of the lap.
    frames: int  #: Images.
    lanes_missed: int  #: Of them, those without a lane found.
    odometry_error_m: float  #: Between where the odometry ends and where the car is.
    odometry_lost: int  #: Frames that the odometry could not match.
    camera_s: float  #: What drawing an image takes; no node's.
    compensation_s: float  #: Node time.
    gaussian_blur_s: float  #: Node time.
    lane_planner_s: float  #: Node time.
    polyfit_s: float  #: Node time.
    red_light_detection_s: float  #: Node time, asleep or not.
    green_light_detection_s: float  #: Node time, asleep or not.
    visual_odometry_s: float  #: Node time.
    lane_control_s: float  #: Node time.


@dataclass(frozen=True, slots=True, kw_only=True)
class DrivingChainRow:
    """The chain in one frame: its nodes as measured in software, and how topic A travels by the model."""

    compensation_ns: int  #: Node time.
    gaussian_blur_ns: int  #: Node time.
    lane_planner_ns: int  #: Node time.
    polyfit_ns: int  #: Node time.
    lane_control_ns: int  #: Node time.
    order: int  #: Drawn order of deliveries, as its place in `Chain.orders`.
    place: int  #: Which of topic A's readers the blur is in that order, from 1.
    smt_s: float  #: From the compensation to the blur over main memory.
    gateway_s: float  #: The same through a gateway.


@dataclass(frozen=True, slots=True, kw_only=True)
class DrivingNodeRow:
    """What the graph assumes of one of the chain's nodes."""

    node: str  #: Its name.
    in_hardware: bool  #: Whether it is placed there.
    hardware_s: float  #: Its time there; NaN where it is not there.


@dataclass(frozen=True, slots=True, kw_only=True)
class DrivingTransferRow:
    """A topic's way along the chain by the memory model, over every order of deliveries."""

    forwarding: str  #: Which set of constants: the gateway core stores chunks, or passes them on as they come.
    topic: str  #: The topic.
    mapping: str  #: One of `MAPPINGS` for topic A; ``as placed`` for the others.
    mean_s: float  #: Mean.
    deviation_s: float  #: Standard deviation.
    shortest_s: float  #: The best order.
    longest_s: float  #: The worst.


@dataclass(frozen=True, slots=True, kw_only=True)
class DrivingTrackRow:
    """A moment of the lap that is drawn."""

    t_s: float  #: Since its start.
    x_m: float  #: The car's true place: east.
    y_m: float  #: North.
    yaw_rad: float  #: Its heading.
    speed_mps: float  #: Its speed.
    left_m: float  #: Its distance to the left of the lane's middle.
    red: str  #: Of each light, 1 for red and 0 for green.
    held: bool  #: Whether the lane control is held by a red light.
    lane_seen: bool  #: Whether the polyfit found a lane.
    lane_offset_m: float  #: Of that lane, in the car's frame; NaN without one.
    lane_slope: float  #: The same.
    lane_bend_per_m: float  #: The same.
    odometry_x_m: float  #: Where the odometry believes to be, from the start pose.
    odometry_y_m: float  #: The same.
    odometry_yaw_rad: float  #: The same.
    command_mps: float  #: Commanded speed.
    command_rps: float  #: Commanded yaw rate.
    pictured: bool  #: Whether the log holds the image of that moment.
