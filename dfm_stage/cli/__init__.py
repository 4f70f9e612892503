"""The commands people type; each module has main(argv) and is listed in dfm_stage.commands."""
