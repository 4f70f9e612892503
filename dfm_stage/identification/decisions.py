"""Numbers that decide in the identification, each with what it was set on."""

from __future__ import annotations

from dfm_stage.decisions import decision

FIRST_FORM = ("not documented; kept from \"diagnose: screen, fit and verify which effect a model "
              "lacks\" (2026-11-21)")
ESTIMATOR = "not documented; kept from the output-error estimator of 2026-11-21"
NEIGHBOUR_FORM = ("not documented; kept from \"a vibration must stand out from its neighbours\" "
                  "(2026-11-21)")

HIGH_BAND = decision(
    "HIGH_BAND", 0.7, "1", meaning="Share of the Nyquist frequency above which only noise is "
    "expected in a first look.", set_on=FIRST_FORM)
NOISE_ORDER = decision(
    "NOISE_ORDER", 40, "1", meaning="Order of the autoregression of the noise at most.",
    set_on=FIRST_FORM)
NOISE_SAMPLES = decision(
    "NOISE_SAMPLES", 50, "samples", meaning="Samples a coefficient of that autoregression takes "
    "at least.", set_on=FIRST_FORM)
LEAK = decision(
    "LEAK", 0.98, "1", meaning="Pole of the filter that turns position into velocity: above 3 Hz "
    "at 1 kHz.", set_on=NEIGHBOUR_FORM)
FORETOLD = decision(
    "FORETOLD", 0.3, "1", meaning=
    "Part of a residual's change that a Jacobian may miss and still be used "
    "again.",
    set_on=ESTIMATOR)
IN_A_ROW = decision(
    "IN_A_ROW", 3, "1", meaning=
    "Times that a Jacobian is used again before it is computed again.",
    set_on=ESTIMATOR)
NEAR = decision(
    "NEAR", 0.03, "1", meaning=
    "Relative change of a nonlinear effect's parameters up to which its "
    "sensitivities are kept.",
    set_on=ESTIMATOR)
FITTED_STEPS = decision(
    "FITTED_STEPS", 64, "steps/sample", meaning=
    "Integration steps a sample from which a model that is fitted counts as not simulable.",
    set_on="three cases of seed 1774353461: of the fits above 2 s, those that led to no name took "
    "49 to 651 steps, all others up to 43")
LINEAR_SHARE = decision(
    "LINEAR_SHARE", 0.05, "1", meaning=
    "Share of the output up to which nonlinear effects are left out of the "
    "sensitivities of the base; a fit that ends above it goes on with them.",
    set_on=ESTIMATOR)
SHARP = decision(
    "SHARP", 0.06, "1", meaning=
    "Noise over the step of a rounded reading, where nothing else is known "
    "of it.",
    set_on=ESTIMATOR)
WEIGHINGS = decision(
    "WEIGHINGS", 3, "1", meaning=
    "Times that records are weighed by what a fit leaves of them.",
    set_on=ESTIMATOR)
LIKE = decision(
    "LIKE", 0.02, "1", meaning=
    "Relative change of a record's noise that leaves its weight as it is.",
    set_on=ESTIMATOR)
FAINTEST = decision(
    "FAINTEST", 1e-9, "1", meaning=
    "Least noise over the motion: an exact fit has a weight, too.",
    set_on=ESTIMATOR)
SAMPLES_EACH = decision(
    "SAMPLES_EACH", 4, "samples", meaning=
    "Least samples for each unknown.",
    set_on=ESTIMATOR)
FIRST_LOOK = decision(
    "FIRST_LOOK", 8, "1", meaning=
    "Iterations after which the best of several starting points is chosen.",
    set_on=ESTIMATOR)
WEAK = decision(
    "WEAK", 0.5, "1", meaning=
    "Standard deviation along a direction, over the parameters, from which "
    "it is reported as weak.",
    set_on=ESTIMATOR)
RANK_TOLERANCE = decision(
    "RANK_TOLERANCE", 1e-6, "1", meaning=
    "Singular value over the largest, below which a direction is not seen "
    "by the data.",
    set_on=ESTIMATOR)
CREEP = decision(
    "CREEP", 8, "1", meaning=
    "Steps over which a search that creeps is judged.",
    set_on=ESTIMATOR)
CREPT = decision(
    "CREPT", 500.0, "1", meaning=
    "Fall of the cost over these steps, in tolerances, below which the "
    "search ends.",
    set_on=ESTIMATOR)
CREPT_SHARE = decision(
    "CREPT_SHARE", 1e-3, "1", meaning=
    "The same as a share of the cost above that of noise, in fits of the diagnosis: where much is "
    "left, the next bit of it tells nothing.",
    set_on="case 1 of seed 1109248463: a fit of a wrong model whose cost fell by 0.2 % in its "
    "last 36 steps")
ACCEPTED = decision(
    "ACCEPTED", 1e-4, "1", meaning=
    "Fall of the cost over the expected one, from which a step is taken.",
    set_on=ESTIMATOR)
NEARLY = decision(
    "NEARLY", 1e-3, "1", meaning=
    "Expected fall of the cost, in variances, below which a search that "
    "finds no step has converged.",
    set_on=ESTIMATOR)
SEEN = decision(
    "SEEN", 1e-14, "1", meaning=
    "Norm of a column over the strongest, above which the data see its "
    "unknown.",
    set_on=ESTIMATOR)
SHARE_OF_LOST = decision(
    "SHARE_OF_LOST", 1e-3, "1", meaning=
    "Share of a direction that is not seen, from which an unknown has no "
    "interval.",
    set_on=ESTIMATOR)
ORDER_ROOM = decision(
    "ORDER_ROOM", 5, "1", meaning=
    "Coefficients by which twice a noise order may fall short of the last "
    "before it is computed again.",
    set_on=ESTIMATOR)
UNCHANGED = decision(
    "UNCHANGED", 1e-6, "1", meaning=
    "Relative change of a figure along a direction that is not seen, up to "
    "which it keeps its interval.",
    set_on=ESTIMATOR)
MOVES = decision(
    "MOVES", 3.0, "1", meaning=
    "RMS of a record over its noise floor, above which a figure of fit is "
    "told.",
    set_on=ESTIMATOR)
FEWEST_HELD_OUT = decision(
    "FEWEST_HELD_OUT", 100, "samples", meaning=
    "Least samples of a last quarter that is predicted.",
    set_on=ESTIMATOR)
MEMBER = decision(
    "MEMBER", 0.2, "1", meaning=
    "Share of the largest relative change from which a parameter is a "
    "member of a direction.",
    set_on=ESTIMATOR)
MOVES_OUTPUT = decision(
    "MOVES_OUTPUT", 0.1, "1", meaning=
    "Share of the largest effect on the output from which it is one as "
    "well.",
    set_on=ESTIMATOR)
EQUAL = decision(
    "EQUAL", 0.15, "1", meaning=
    "Spread over the largest, up to which changes are equal in words.",
    set_on=ESTIMATOR)
SAME_PERIOD = decision(
    "SAME_PERIOD", 1e-6, "1", meaning="Relative difference of two sampling periods that are the "
    "same.", set_on=FIRST_FORM)

# -- the convention of the input -----------------------------------------------------------------

TIMING_FORM = ("held and continuous simulations (five kinds of stage, four inputs), and "
               "Silverbox, looked at while it was set: not a blind result")
HELD_LEAST = decision(
    "HELD_LEAST", 0.3, "samples", meaning="An input that acts surely earlier than this is not "
    "held; a held one acts at 0.5 or later, 0.38 with what the regression does not know.",
    set_on=TIMING_FORM)
HELD_SIGMAS = decision(
    "HELD_SIGMAS", 4.0, "standard errors", meaning="A difference of so many counts as certain.",
    set_on=TIMING_FORM)
LATE_RATIO = decision(
    "LATE_RATIO", 1.3, "1", meaning="What the regression leaves with an input that is half a "
    "sample late or more, over what it leaves at best, above which it is not held: a second mode "
    "reaches 1.1.", set_on=TIMING_FORM)
UNEXPLAINED = decision(
    "UNEXPLAINED", 0.3, "1", meaning="Share of the input's RMS that the regression may leave and "
    "still tell its timing: a second mode in the middle of the band leaves 0.9.",
    set_on=TIMING_FORM)
TIMING_KNOWN = decision(
    "TIMING_KNOWN", 0.1, "samples", meaning="Standard error above which a record does not show "
    "when its input acts.", set_on=TIMING_FORM)
TIMING_FLOOR = decision(
    "TIMING_FLOOR", 0.01, "samples", meaning="Least standard error that is told: the regression "
    "is no exact model.", set_on=TIMING_FORM)
TIMING_BLOCKS = decision(
    "TIMING_BLOCKS", 20, "1", meaning="Parts of a record, each left out once, whose spread is the "
    "standard error.", set_on=TIMING_FORM)
HOLD_CLEAR = decision(
    "HOLD_CLEAR", 0.5, "1", meaning="Chi-square above that of noise that another kind of hold "
    "leaves, over that of the estimated kind, below which it is the kind: before any effect is "
    "added, and with the effects found where these leave more than noise. Of an input that acts "
    "later than the stage as given, all that is left counts.",
    set_on="six cases of three seeds that are not held: below 0.25; 90 others of seed 424242, "
    "which lack an effect: above 0.8 where the model has a lag to fit; two outputs that are early "
    "by a sample: below 0; looked at while it was set")
EARLY_SHIFT = decision(
    "EARLY_SHIFT", 0.1, "samples", meaning="A shift smaller than this is none.",
    set_on=TIMING_FORM)
EARLIEST = decision(
    "EARLIEST", -1.0, "samples", meaning="An input that acts earlier than this is no matter of "
    "columns, and shows nothing.", set_on="derivation: a logger swaps columns by one sample; the "
    "harvester's velocity leads its input's column by 1.4")
FINER = decision(
    "FINER", 4, "steps", meaning="Steps a sample, at most, for an input that is not held.",
    set_on="derivation: the images of a frequency f lie at 4 - f sampling rates and beyond, and a "
    "mass moves by (f / (4 - f))^3 of the motion at f: 1e-4 at a fifth of the rate")
FOLLOWED = decision(
    "FOLLOWED", 1e-6, "1", meaning="Motion by these images, over all motion, up to which fewer "
    "steps are taken.", set_on="derivation: 1e-4 of the motion is as much as the noise of a fine "
    "encoder; a hundredth of that adds less than 1 to the chi-square of 10,000 samples")
MOTION_ABOVE_NOISE = decision(
    "MOTION_ABOVE_NOISE", 4.0, "1", meaning="Mean power of neighbouring lines over that of noise "
    "from which a measured velocity or acceleration is integrated there.", set_on="derivation: "
    "the mean over three lines of noise exceeds 4 in 5 of 10,000")

# -- lost samples --------------------------------------------------------------------------------

DROPS = "simulation: 0.1 % of samples dropped, against 40 healthy records of various inputs"
LOST_CLEAR = decision(
    "LOST_CLEAR", 8.0, "standard deviations", meaning="Error of a one-step predictor over a few "
    "samples, above which some may be missing.", set_on=DROPS)
LOST_EXPLAINED = decision(
    "LOST_EXPLAINED", 0.2, "1", meaning="Squares of these errors that may stay once the samples "
    "are put in.", set_on=DROPS)
LOST_OTHERWISE = decision(
    "LOST_OTHERWISE", 0.4, "1", meaning="The same over what a spike of the reading or a push on "
    "the stage leaves.", set_on=DROPS)
LOST_CURVED = decision(
    "LOST_CURVED", 3.0, "1", meaning="Distance of a reading put in from the line between its "
    "neighbours, over what the motion around it allows.", set_on="derivation: the motion around "
    "it is known by some twenty samples only")
LOST_IN_A_ROW = decision(
    "LOST_IN_A_ROW", 3, "samples", meaning="Samples that are looked for in one place.",
    set_on="derivation: more are seldom lost without a trace, and each frees two values")
LOST_AT_MOST = decision(
    "LOST_AT_MOST", 0.01, "1", meaning="Share of lost samples above which the predictor is taken "
    "to be wrong.", set_on="derivation: of six samples that a predictor looks back one would be "
    "spoilt in 17, and it would not be known")
