from tests.helpers.synthetic_needs import platforms_stay_open  # noqa: F401
