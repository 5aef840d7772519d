"""Measures stripe extraction on synthetic stripes whose centre is known."""

from __future__ import annotations

import argparse

from testbed.synthetic_stripes import CASES, COLUMNS, SIGMA_PX, STRIPES, figures


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--method", default="precise,paper", help="comma-separated methods")
    arguments = parser.parse_args()
    print(f"{STRIPES} stripes of {COLUMNS} columns, Gaussian of sigma {SIGMA_PX} px, seed 0; errors in px")
    print("case       method     mean    p95  missed %  false %  error/sigma")
    for case in CASES:
        for method in arguments.method.split(","):
            f = figures(case, method)
            print(
                f"{case.name:<10} {method:<8} {f['mean']:6.3f} {f['p95']:6.3f} {f['missed']:9.2f} {f['false']:8.2f} "
                f"{f['sigma_ratio']:12.2f}"
            )


if __name__ == "__main__":
    main()
