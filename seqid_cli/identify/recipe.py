"""How a stage was identified, as its file records it, to identify it alike again.

What the logs themselves decide (orders that were not given, the motion that is better)
is no part of a recipe: it is decided anew.
"""

from typing import TypeVar

from seqid_cli.identify.options import FrictionOptions, RigidOptions
from seqid_cli.params.schema import FrictionStage, Recipe, RigidStage
from seqid_cli.settings import Settings, with_values

S = TypeVar("S", bound=Settings)


def friction_recipe(options: FrictionOptions) -> Recipe:
    """Return what a user has asked of friction, for its file."""
    return Recipe(
        position_order=options.position_order,
        velocity_order=options.velocity_order,
        beta=options.beta,
    )


def rigid_recipe(options: RigidOptions) -> Recipe:
    """Return what a user has asked of a rigid body, for its file.

    Parameters
    ----------
    options : RigidOptions
        What the user has asked for.
    """
    return Recipe(source=options.source, consistent=options.consistent)


def recipe_of(stage: FrictionStage | RigidStage | None) -> Recipe:
    """Return the recipe of a stage; the default one where its file has none."""
    if stage is None or stage.recipe is None:
        return Recipe()
    return stage.recipe


def friction_options(stage: FrictionStage) -> FrictionOptions:
    """Return the options that a friction stage was identified with."""
    recipe = recipe_of(stage)
    return FrictionOptions(
        position_order=recipe.position_order,
        velocity_order=recipe.velocity_order,
        beta=recipe.beta,
    )


def stage_settings(stage: FrictionStage | RigidStage, defaults: S) -> S:
    """Return the settings that a stage was identified with.

    Parameters
    ----------
    stage : FrictionStage or RigidStage
        The stage of a file.
    defaults : Settings
        Those of its command, for files that have none.
    """
    if stage.settings is None:
        return defaults
    return with_values(defaults, stage.settings.changed)
