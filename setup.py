"""What pyproject.toml cannot say: the simulated arm's dynamics are plain C, without Python headers."""

from setuptools import Extension, setup

setup(
    ext_modules=[
        Extension(
            "firmware_sim.arm._dynamics",
            sources=["firmware_sim/arm/dynamics.c"],
            # Plain IEEE 754, so that a run gives the same bytes on every machine; sqrt's errno nobody reads.
            extra_compile_args=["-std=c11", "-O3", "-ffp-contract=off", "-fno-math-errno"],
            libraries=["m"],
        )
    ]
)
