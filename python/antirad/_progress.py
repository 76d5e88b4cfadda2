"""Bars of tqdm for the argument `progress=True`."""

import math


def _bar(**options):
    try:
        from tqdm.auto import tqdm
    except ImportError as error:
        raise ImportError(
            "progress=True shows a bar of tqdm, which is not installed: pip install tqdm, or give a function"
        ) from error
    return tqdm(**options)


def solve_bar(tolerance):
    """Show the digits of the residual that a solve has gained."""
    digits = -math.log10(tolerance)
    bar = _bar(total=round(digits, 2), desc="solve", unit="digit", bar_format="{l_bar}{bar}| {postfix}")

    def report(passes, residual, share):
        gained = min(max(-math.log10(max(residual, 1e-300)), 0.0), digits)
        bar.set_postfix_str(f"{passes + share:.1f} passes, residual {residual:.1e}", refresh=False)
        bar.update(max(gained - bar.n, 0.0))
        if residual <= tolerance:
            bar.close()
        else:
            bar.refresh()

    return report


def fit_bar(iterations):
    """Show the iterations of a fit."""
    bar = _bar(total=iterations, desc="fit", unit="it")

    def report(record):
        bar.set_postfix_str(f"loss {record['loss']:.3e}", refresh=False)
        bar.update(record["iteration"] - bar.n)

    return report


def steps_bar(unit):
    """Show steps of equal length."""
    bar = _bar(unit=unit)

    def report(done, total):
        bar.total = total
        bar.update(done - bar.n)
        if done == total:
            bar.close()

    return report
