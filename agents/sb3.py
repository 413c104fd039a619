"""Policies saved by stable-baselines3; this module imports torch."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

from stable_baselines3.common.save_util import load_from_zip_file

from pendulum_env.errors import UserError, format_error
from pendulum_env.reading import check_size


def load_policy(path: str | Path) -> Any:
    """Load the policy of a model that an algorithm of stable-baselines3 saved as `.zip`.

    The file contains pickles, which can run code: load only trusted files.

    Raises:
        UserError: if the file cannot be read, or is no model.
    """
    check_size(path)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about versions that differ from those of the file
            data, parameters, _ = load_from_zip_file(path, device="cpu")
        if data is None:
            raise ValueError("it holds no description of the policy")
        arguments = dict(data["policy_kwargs"])
        if data.get("use_sde"):
            arguments["use_sde"] = True
        policy = data["policy_class"](data["observation_space"], data["action_space"], lambda left: 0.0, **arguments)
        policy.load_state_dict(parameters["policy"])
    except Exception as error:  # a broken or foreign file may raise anything
        raise UserError(f"{path}: is no model that stable-baselines3 saved: {format_error(error)}") from error
    policy.set_training_mode(False)
    return policy
