"""Numbers that order and bound the search of a diagnosis, each with what it was set on."""

from __future__ import annotations

from dfm_stage.decisions import decision
from dfm_stage.diagnosis.decisions import FIRST_FORM

BOUND = "processor time: no diagnosis of 60,000 samples above 60 s"

NOISE_SHARES = (0.02, 0.035, 0.06, 0.085, 0.115, 0.15, 0.2)
"""RMS of the noise before rounding, over the step, that are tried."""


def _search(name: str, value: float, unit: str, meaning: str, set_on: str = FIRST_FORM) -> float:
    return decision(name, value, unit, meaning=meaning, set_on=set_on)


PER_PARAMETER = _search("PER_PARAMETER", 12.0, "chi-square", "What a further parameter must bring "
                        "for the larger of two models to be preferred in the search.",
                        FIRST_FORM + "; dearer than `AKAIKE`, as the best of many fits is taken "
                        "and errs towards more parameters: at 2 the larger effect leads in 3 of "
                        "64 kept cases of friction, at 4 in 2 of these, all of severity 0.1 "
                        "or 0.3 and of the same class; it is the right one in 2 of the 3")
AKAIKE = _search("AKAIKE", 2.0, "chi-square", "What a parameter costs where rivals are compared.",
                 "derivation: Akaike's information criterion between two fits; a search among "
                 "many pays `PER_PARAMETER`")
FURTHER_SHARE = _search("FURTHER_SHARE", 0.2, "1", "Share of what is left above the noise that a "
                        "further effect must take: bits are no physics.")
MOST_EFFECTS = decision("MOST_EFFECTS", 4, "1", meaning="Effects that are added at most.",
                        set_on=FIRST_FORM)
PROMISED = _search("PROMISED", 0.5, "1", "Share of a limit that the screen must promise for a "
                   "fit; share of the promise below which a fit begins again.")
SHORT_LIST = decision("SHORT_LIST", 4, "1", meaning="Candidates, and rivals of one effect, that "
                      "are fitted at most.", set_on=FIRST_FORM)
SCREENS_KEPT = _search("SCREENS_KEPT", 4, "1", "Screens that are remembered: each holds the "
                       "responses of all candidates.")
LOOKED_CLOSELY = _search(
    "LOOKED_CLOSELY", 24, "1", "Starting points of one effect that are screened beside nonlinear "
    "effects: those that promise most beside the linear model that moves alike.",
    "22 screens of second_mode and sensor_mount in four cases of seed 30001: the best of 106 to "
    "126 points is among 24 in all, among 16 in 19; two of the others lose 0.2 and 0.7 % of its "
    "gain, one gains nothing")
MOVES_ALIKE = _search(
    "MOVES_ALIKE", 0.2, "1", "Difference of the linear model's motion over the motion, up to "
    "which it may say which starting points promise most.",
    "a cubic spring of four sizes beside drag or friction: the best of 126 points comes 1st to "
    "5th up to 0.2, 73rd to 84th from 0.3")
SHORT_LIST_GAIN = _search("SHORT_LIST_GAIN", 0.8, "1", "Share of the best screened gain from "
                          "which a candidate is fitted.")
FULL_SHARE = _search("FULL_SHARE", 0.985, "1", "Share of what is above the noise that one fit "
                     "must take for no other to be tried beside it.")
WORTH = _search("WORTH", 0.2, "1", "Share of the gap by which a fit may be worse than the best "
                "for its last parameters to be freed.")
PAIR_MEMBER = _search("PAIR_MEMBER", 0.02, "1", "Share of the best screened gain from which a "
                      "candidate is screened in pairs.")
PAIR_GAIN = _search("PAIR_GAIN", 1.02, "1", "Screened gain of a pair over the fitted one of the "
                    "best single effect, from which it is fitted.")
RESTART_ABOVE = _search("RESTART_ABOVE", 1.03, "1", "Chi-square a sample above which a fit leaves "
                        "more than noise, and effects are searched again beside the others.")
NEAR_NOISE = _search("NEAR_NOISE", 1.15, "1", "Chi-square a sample up to which uncommon effects "
                     "are tested before several common ones are looked for, and up to "
                     "which a search begins with effects that explain a part; power left over "
                     "that of its high frequencies, above which it has a colour; held-out "
                     "power over the noise, above which there is more than noise in it, and "
                     "beyond which intervals allow for what a remainder hides.",
                     "simulation: the high frequencies of 4000 samples of white noise tell its "
                     "power within 7.5 %, one standard deviation; this is two")
TWIN_ABOVE = _search("TWIN_ABOVE", 1.01, "1", "Chi-square a sample above which the twin of an "
                     "effect just added is tried in its place.")
EXCHANGES = decision("EXCHANGES", 3, "1", meaning="Times that a rival may take an effect's place.",
                     set_on=FIRST_FORM)
NOISE_MOVED = _search("NOISE_MOVED", 0.03, "1", "Relative change of the noise from which fits are "
                      "weighed again.")
RELATED_GAIN = _search("RELATED_GAIN", 0.9, "1", "Screened gain of a rival of the same class, "
                       "over the effect's own, from which it is fitted in its place.")
UNRELATED_GAIN = _search("UNRELATED_GAIN", 0.97, "1", "The same for a rival of no common class.")
ROUNDING_GAIN = _search("ROUNDING_GAIN", 0.25, "1", "The same for a rounding beside a periodic "
                        "error of its step: its gain suffers from every error of the motion.")
ROUNDED_GAIN = _search("ROUNDED_GAIN", 0.02, "chi-square/sample", "Fall that a further effect "
                       "must bring beside a rounding: what it leaves is not noise.")
ROUGH_NOISE = _search("ROUGH_NOISE", 1e-3, "1", "Noise over the motion before anything is known "
                      "of it.")
POLISHED = _search("POLISHED", 1e-3, "chi-square", "Fall a step at which a fit whose values are "
                   "told ends.", "derivation: 0.03 standard errors")
AROUND_STEPS = decision("AROUND_STEPS", 8, "1", meaning="Iterations of a fit of all else around "
                        "new effects.", set_on=FIRST_FORM)
LEAST_TRAVEL = _search("LEAST_TRAVEL", 10.0, "1", "Motion over noise below which errors of the "
                       "scale are not screened.")
UNSEEN_PART = _search("UNSEEN_PART", 1e-6, "1", "Part of a response that the free parameters do "
                      "not follow, below which it is rounding.")
SCREEN_RANK = _search("SCREEN_RANK", 1e-7, "1", "Singular value over the largest, above which a "
                      "direction is taken out of screened responses.")
AT_END = _search("AT_END", 0.999, "1", "Share of the upper end of its range from which a "
                 "parameter is at it.")
BENT = _search("BENT", 2.0, "1", "Factor between the force constant as given and as re-estimated "
               "from which the base stands in for what is missing: a fit begins at the base as "
               "given, too.", "seed 1774353461: slow motion shows but the ratio of force constant "
               "and stiffness, and friction moves both by a factor of 370 in one case")
DRY = _search("DRY", 1.01, "1", "Distance over the lower end of its range up to which it is at "
              "it.", "derivation: fits stop within a percent of an end they run to")
MOST_TO_ONE = _search("MOST_TO_ONE", 0.9, "1", "Share of the whole lateness that one parameter "
                      "gets when it is distributed again.")
STEPS_BEFORE_SLOW = _search("STEPS_BEFORE_SLOW", 48e6, "steps", "Integration steps after which no "
                            "further candidate that is slow to simulate is tried.", BOUND)
STEPS_BEFORE_LINEAR = _search("STEPS_BEFORE_LINEAR", 60e6, "steps", "The same for any with a "
                              "nonlinear force.", BOUND)
FARTHEST_SHIFT = decision(
    "FARTHEST_SHIFT", 2.0, "standard errors", meaning="By so much an estimated shift of the input "
    "is moved at most to where the model leaves least.",
    set_on="derivation: 95 % of errors are smaller")
CONVENTION_PRICE = decision(
    "CONVENTION_PRICE", 1, "1", meaning="Parameters that another convention of the input counts "
    "for; it must spare more.", set_on="derivation: its kind; when it acts is measured")
HOLDS_DIFFER = decision(
    "HOLDS_DIFFER", 0.05, "sampling rates", meaning="Frequency of a mode from which an error of "
    "the input's timing may look like it.", set_on="derivation: below it a hold weakens the input "
    "by less than 0.4 %, and its delay is fitted; modes that stood for such errors in 7 cases of "
    "two seeds lie at 0.09 to 0.55")
CONVENTION_WORSE = decision(
    "CONVENTION_WORSE", 1.01, "1", meaning="RMS of held-out records that another kind leaves "
    "over that left by the estimated one and a fast mode, up to which it predicts as well.",
    set_on="four cases of seed 1498568968, in which an error of timing was named second_mode")
MOST_STEPS = _search("MOST_STEPS", 100e6, "steps", "Integration steps of one search after which "
                     "its fits end where they are: among common effects, and among all.", BOUND)
GRADING_STEPS = _search("GRADING_STEPS", 50e6, "steps", "Integration steps of the search for "
                        "effects that explain a part.", BOUND)
FIRST_SHARE = _search("FIRST_SHARE", 0.5, "1", "Share of MOST_STEPS after which the first effects "
                     "must be found: the rest is for what follows.", BOUND)
LEAST_STEPS = _search("LEAST_STEPS", 15e6, "steps", "Integration steps that are left at least "
                      "to what follows a search: a grading, or the search to the noise.", BOUND)
STEPS_A_FIT = _search("STEPS_A_FIT", 24e6, "steps", "Integration steps of one fit at most.", BOUND)
