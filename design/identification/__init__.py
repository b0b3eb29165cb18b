"""Plant models from recorded experiments: estimators, validation, and checks of records and models.

``identify`` has the entry points. ``records`` holds the data as the estimators take them, ``models`` the
structures of models, ``estimators`` the fits, ``analysis`` what is computed from a fit, and ``checks`` what
speaks against a record or a model.
"""
