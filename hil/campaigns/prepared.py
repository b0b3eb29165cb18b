"""A campaign with the documents that its cases need, so that a case reads no file.

Rig, controllers and setpoints are read once, before the first case. So an error in them is found at once, a
file that is changed meanwhile changes no case, and a case can run on another machine.
"""

from __future__ import annotations

import functools
from pathlib import Path
from typing import NamedTuple, TypeAlias

from hil.campaigns.campaign_file import Campaign, Setup
from hil.shells.run_setup import RunSetup, load_setup, setup_from_texts

_Texts: TypeAlias = tuple[tuple[str, str], ...]


class SetupDocuments(NamedTuple):
    """The documents of one set-up."""

    texts: _Texts
    """Name and text of each document, as a recording holds them."""
    setpoints: _Texts
    """Name and setpoint of each axis."""


class PreparedCampaign(NamedTuple):
    """A campaign and the documents of its set-ups, in the order of the file."""

    campaign: Campaign
    setups: tuple[SetupDocuments, ...]


def prepare(campaign: Campaign) -> PreparedCampaign:
    """Read the files that a campaign names. Raises DocumentError or SetpointError."""
    return PreparedCampaign(campaign, tuple(_documents(campaign, setup) for setup in campaign.setups))


@functools.lru_cache(maxsize=64)
def build_setup(documents: SetupDocuments) -> RunSetup:
    """Return the set-up of which these are the documents. One set-up serves many cases."""
    return setup_from_texts(dict(documents.texts), dict(documents.setpoints))


def _documents(campaign: Campaign, setup: Setup) -> SetupDocuments:
    path = None if campaign.rig is None else Path(campaign.rig)
    loaded = load_setup(path, setup.controllers, setup.setpoints)
    setpoints = tuple((name, setpoint.text) for name, setpoint in loaded.setpoints.items())
    return SetupDocuments(tuple(loaded.texts.items()), setpoints)
