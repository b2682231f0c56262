"""Settings of the stages, of `predict`, and of what they share; no heavy imports."""

from dataclasses import dataclass

from seqid_cli.settings import Group, Settings, setting


@dataclass(frozen=True, kw_only=True)
class JudgingSettings(Group):
    """What a result must keep to, by physics and by the stages before."""

    clear_sigma: float = setting(
        4.0,
        unit="standard errors",
        reason=(
            "beyond which friction that drives, or an inertia below zero, is no chance"
        ),
        low=0.5,
        high=20.0,
    )
    driving_share: float = setting(
        0.03,
        unit="of the usual friction",
        reason="negative friction that is too small to mean anything",
        low=0.0,
        high=10.0,
    )
    driving_cells: float = setting(
        0.02,
        unit="of positions and speeds",
        reason="corners of a friction surface that may be negative",
        low=0.0,
        high=0.999,
    )
    max_gravity_difference: float = setting(
        0.25,
        unit="of a joint's gravity torque",
        reason="by which gravity of two stages may differ",
        low=0.0,
        high=10.0,
    )
    max_gravity_factor: float = setting(
        2.5,
        unit="times",
        reason="by which gravity may differ from that of the URDF's inertials",
        low=1.01,
        high=1e6,
    )
    min_gravity_correlation: float = setting(
        0.3,
        unit="correlation",
        reason="with gravity of the URDF's inertials, below which it points elsewhere",
        low=-1.0,
        high=1.0,
    )
    light_share: float = setting(
        0.05,
        unit="of the largest gravity torque",
        reason="joints that carry less are not compared",
        low=0.0,
        high=1.0,
    )
    min_gravity_torque: float = setting(
        1e-3,
        unit="N m",
        reason="gravity torques below it show nothing",
        low=0.0,
        high=1e3,
    )


@dataclass(frozen=True, kw_only=True)
class TrialSettings(Group):
    """Which trials belong together."""

    same_configuration: float = setting(
        0.03,
        unit="rad",
        reason="by which locked joints of one configuration may stand apart",
        low=1e-6,
        high=1.0,
    )


@dataclass(frozen=True, kw_only=True)
class HuntingSettings(Group):
    """Slow trials in which a joint stops between counts of its encoder."""

    max_speed_swing: float = setting(
        1.4,
        unit="times the speed",
        reason=(
            "by which the velocity would swing without friction, and the joint stops"
        ),
        low=0.1,
        high=1e3,
    )


@dataclass(frozen=True, kw_only=True)
class SurfaceSettings(Group):
    """The friction surface of a joint and its verdict."""

    max_error: float = setting(
        0.15,
        unit="of the friction at a speed",
        reason="error of the surface from which the joint is poor",
        low=1e-3,
        high=10.0,
    )
    sign_narrowness: float = setting(
        25.0,
        unit="of the slowest speed",
        reason="the part of it over which friction changes its sign: 25 is a 25th",
        low=2.0,
        high=1e4,
    )


@dataclass(frozen=True, kw_only=True)
class FrictionSettings(Settings):
    """The settings of `friction`."""

    judging: JudgingSettings = JudgingSettings()
    surface: SurfaceSettings = SurfaceSettings()
    trials: TrialSettings = TrialSettings()
    hunting: HuntingSettings = HuntingSettings()


@dataclass(frozen=True, kw_only=True)
class GravityFitSettings(Group):
    """The rows of the gravity stage and its verdict."""

    settling: float = setting(
        0.03,
        unit="s",
        reason=(
            "left out at either end of a trial, where the joint still changes its speed"
        ),
        low=0.0,
        high=2.0,
    )
    settling_share: float = setting(
        0.125,
        unit="of a trial",
        reason="the most that is left out at either end of it",
        low=0.0,
        high=0.45,
    )
    max_condition: float = setting(
        300.0,
        unit="condition",
        reason="from which the postures tell the parameters too badly apart: poor",
        low=1.0,
        high=1e9,
    )
    max_left: float = setting(
        2.5,
        unit="times friction's residual",
        reason=(
            "left by one gravity for all postures, from which a joint is usable only"
        ),
        low=0.1,
        high=1e3,
    )
    shown_sigma: float = setting(
        4.0,
        unit="standard errors",
        reason=(
            "from which gravity shows in the torque, and a change of friction between"
            " logs"
        ),
        low=0.5,
        high=50.0,
    )
    min_friction_change: float = setting(
        0.01,
        unit="of friction",
        reason="between two logs, from which friction is usable only",
        low=1e-4,
        high=10.0,
    )


@dataclass(frozen=True, kw_only=True)
class GravitySettings(Settings):
    """The settings of `gravity`."""

    judging: JudgingSettings = JudgingSettings()
    fit: GravityFitSettings = GravityFitSettings()
    trials: TrialSettings = TrialSettings()


@dataclass(frozen=True, kw_only=True)
class MountingSettings(Group):
    """The calibration of an IMU and its verdict."""

    max_error: float = setting(
        0.5,
        unit="degrees",
        reason="standard error of the mounting from which it is poor",
        low=1e-3,
        high=90.0,
    )
    max_left_out: float = setting(
        1.5,
        unit="times the noise",
        reason="error at a log that is left out, from which the mounting is poor",
        low=1.0,
        high=1e3,
    )
    max_cutoff: float = setting(
        20.0,
        unit="Hz",
        reason="cut-off of readings and encoders where --cutoff is left out",
        low=0.5,
        high=500.0,
    )


@dataclass(frozen=True, kw_only=True)
class ImuCalibSettings(Settings):
    """The settings of `imu-calib`."""

    mounting: MountingSettings = MountingSettings()


@dataclass(frozen=True, kw_only=True)
class CutoffSettings(Group):
    """Limits of an admissible cut-off, and of a gain that is worth another one."""

    max_acceleration_noise: float = setting(
        5e-3,
        unit="of the motion's power",
        reason="noise N / S in the acceleration, which shrinks an inertia by as much",
        low=1e-6,
        high=1.0,
    )
    min_samples_per_rank: float = setting(
        3.0,
        unit="independent samples per direction",
        reason="covariances of many parameters from few samples",
        low=1.0,
        high=1e4,
    )
    max_disagreement: float = setting(
        0.02,
        unit="of the torque's RMS",
        reason="by which parameters of neighbouring cut-offs may differ",
        low=1e-4,
        high=1.0,
    )
    nearly_best: float = setting(
        1.1,
        unit="times the least error",
        reason="within which a cut-off nearer to the start is taken",
        low=1.0,
        high=10.0,
    )
    clear_sigma: float = setting(
        1.0,
        unit="standard errors of the difference",
        reason="within which two cut-offs are as good",
        low=0.0,
        high=20.0,
    )
    hopeless: float = setting(
        1.2,
        unit="times the least error",
        reason="from which no cut-off further on is tried",
        low=1.0,
        high=100.0,
    )


@dataclass(frozen=True, kw_only=True)
class CutoffCheckSettings(Group):
    """Whether parameters depend on the cut-off."""

    noted_sigma: float = setting(
        4.0,
        unit="standard errors of the difference",
        reason="from which a parameter is said to depend on the cut-off",
        low=0.5,
        high=50.0,
    )
    usable_sigma: float = setting(
        3.0,
        unit="stated standard errors",
        reason="by which one must depend on it to make the stage usable only",
        low=0.5,
        high=50.0,
    )


@dataclass(frozen=True, kw_only=True)
class RotorSettings(Group):
    """Whether rotors are coupled to the links that carry them."""

    max_sigma: float = setting(
        3.0,
        unit="standard errors",
        reason="within which the free share of the coupling agrees with 0 or 1",
        low=0.5,
        high=50.0,
    )
    min_log_odds: float = setting(
        5.0,
        unit="log odds",
        reason="from which it is decided on; 5 is 150 to 1",
        low=0.1,
        high=100.0,
    )


@dataclass(frozen=True, kw_only=True)
class AgreementSettings(Group):
    """Whether all logs are of one rigid body."""

    max_left: float = setting(
        0.7,
        unit="of a joint's RMS residual",
        reason="left by two bodies, above which logs do not differ",
        low=0.01,
        high=1.0,
    )
    min_certainty: float = setting(
        5.0,
        unit="F value",
        reason="fall of the residual that chance does not make",
        low=1.0,
        high=1e4,
    )
    usable_share: float = setting(
        0.01,
        unit="of a joint's torque",
        reason="that differs between logs, from which the stage is usable only",
        low=0.0,
        high=1.0,
    )
    poor_share: float = setting(
        0.05,
        unit="of a joint's torque",
        reason="that differs between logs, from which the stage is poor",
        low=0.0,
        high=1.0,
    )


@dataclass(frozen=True, kw_only=True)
class ResidualLimits(Group):
    """How much of a joint's torque a fitted model may leave."""

    poor_share: float = setting(
        0.15,
        unit="of the torque's RMS",
        reason="left, from which a joint is poor",
        low=1e-4,
        high=10.0,
    )
    max_of_noise: float = setting(
        1.2,
        unit="times the noise's upper end",
        reason="left, from which more than noise is: usable only",
        low=0.1,
        high=1e3,
    )


@dataclass(frozen=True, kw_only=True)
class ResidualSettings(ResidualLimits):
    """What may be left of a joint's torque."""

    max_condition: float = setting(
        1000.0,
        unit="condition",
        reason="from which the moves tell the parameters too badly apart: poor",
        low=1.0,
        high=1e9,
    )


@dataclass(frozen=True, kw_only=True)
class ReversalSettings(Group):
    """Rows about reversals."""

    settled_periods: float = setting(
        1.0,
        unit="periods of the cut-off",
        reason=(
            "left out about reversals, where friction at the onset of sliding is"
            " mixed in"
        ),
        low=0.0,
        high=3.0,
    )


@dataclass(frozen=True, kw_only=True)
class InertiaSettings(Settings):
    """The settings of `inertia`."""

    judging: JudgingSettings = JudgingSettings()
    residual: ResidualSettings = ResidualSettings()
    reversals: ReversalSettings = ReversalSettings()
    cutoff: CutoffSettings = CutoffSettings()
    cutoff_check: CutoffCheckSettings = CutoffCheckSettings()
    rotors: RotorSettings = RotorSettings()
    agreement: AgreementSettings = AgreementSettings()


@dataclass(frozen=True, kw_only=True)
class OneStepSettings(ResidualLimits):
    """What the one-step identification makes of what is left, and of friction."""

    poor_share: float = setting(
        0.25,
        unit="of the torque's RMS",
        reason="left, from which a joint is poor",
        low=1e-4,
        high=10.0,
    )
    negative_sigma: float = setting(
        3.0,
        unit="standard errors",
        reason="by which Coulomb friction must be below zero to be poor",
        low=0.5,
        high=50.0,
    )
    wave_sigma: float = setting(
        3.0,
        unit="standard errors",
        reason="from which friction certainly waves over the position",
        low=0.5,
        high=50.0,
    )
    wave_share: float = setting(
        0.03,
        unit="of Coulomb friction",
        reason="from which such a wave matters: usable only",
        low=0.0,
        high=1.0,
    )


@dataclass(frozen=True, kw_only=True)
class SimultaneousSettings(Settings):
    """The settings of `simultaneous`."""

    judging: JudgingSettings = JudgingSettings()
    residual: OneStepSettings = OneStepSettings()
    cutoff: CutoffSettings = CutoffSettings()
    agreement: AgreementSettings = AgreementSettings()


@dataclass(frozen=True, kw_only=True)
class PredictionErrorSettings(Group):
    """When a prediction can be relied on."""

    max_relative_rmse: float = setting(
        0.3,
        unit="of the torque's RMS while sliding",
        reason="error from which the prediction of a joint is poor",
        low=1e-3,
        high=10.0,
    )
    min_band_share: float = setting(
        0.8,
        unit="of the samples",
        reason="in the 90 % band, below which a joint is usable only",
        low=0.0,
        high=0.9,
    )


@dataclass(frozen=True, kw_only=True)
class PredictSettings(Settings):
    """The settings of `predict`."""

    judging: JudgingSettings = JudgingSettings()
    errors: PredictionErrorSettings = PredictionErrorSettings()
