# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The command line of histories that are played for long."""

import argparse
import gc


def play_many(play, description):
    """
    Play histories of successive seeds, and print how many steps there were.

    `play` plays that of a seed without a loss, and returns how many steps it had.
    """
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument('steps', type=int)
    parser.add_argument('--first', type=int, default=0, metavar='SEED')
    arguments = parser.parse_args()
    steps, seed = 0, arguments.first
    while steps < arguments.steps:
        try:
            steps += play(seed)
        except AssertionError as error:
            raise SystemExit(f'seed {seed}, after {steps} steps: {error}') from error
        seed += 1
        if seed == arguments.first + 1:
            # What numba made takes longer to look through than a history takes to play.
            gc.freeze()
        if seed % 100 == 0:
            print(f'{steps} steps of {seed - arguments.first} histories, none lost', flush=True)
    print(f'{steps} steps of {seed - arguments.first} histories, none lost')
