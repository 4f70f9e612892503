"""dfm_stage: simulation, identification, control and diagnosis of a flexure scanning stage."""

__version__ = "0.1.0"
