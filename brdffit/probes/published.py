"""L1 errors of preimages that Manson and Sloan 2016 print in their tables 1 to 3, for comparison with ours."""

#: Table 1, mean of levels 1 to 6: (terms, taps a frame) and samples of importance sampling.
TABLE_1 = {
    ("const", 8): 0.1111, ("const", 16): 0.0815, ("const", 32): 0.0613,
    ("quadratic", 8): 0.0848, ("quadratic", 16): 0.0656, ("quadratic", 32): 0.0506,
}  # fmt: skip
TABLE_1_SAMPLES = {32: 0.4201, 64: 0.2976, 128: 0.2233, 1024: 0.0887}
#: Table 2, levels 0 to 6.
TABLE_2 = {
    "quadratic 32x3": (0.0495, 0.0461, 0.0516, 0.0410, 0.0394, 0.0502, 0.0758),
    "importance 4096": (0.2484, 0.0502, 0.0375, 0.0517, 0.0521, 0.0512, 0.0575),
}
#: Table 3, irradiance: tables, and orders of harmonics.
TABLE_3 = {
    ("const", 8): 0.1460, ("const", 16): 0.1186, ("const", 32): 0.0933,
    ("quadratic", 8): 0.1181, ("quadratic", 16): 0.0996, ("quadratic", 32): 0.0793,
}  # fmt: skip
TABLE_3_ORDERS = {3: 0.1227, 5: 0.0593, 7: 0.0358, 9: 0.0243, 11: 0.0177}
