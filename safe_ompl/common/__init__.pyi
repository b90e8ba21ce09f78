from . import documents as documents, files as files, polynomials as polynomials
from .documents import (
    RATE_BOUNDS as RATE_BOUNDS,
    BoolArray as BoolArray,
    FloatArray as FloatArray,
    IntArray as IntArray,
    Section as Section,
    configuration as configuration,
    configurations as configurations,
    finite_array as finite_array,
    flag as flag,
    float_array as float_array,
    fraction as fraction,
    instance as instance,
    key as key,
    motion_ends as motion_ends,
    number as number,
    seed as seed,
    shaped_configuration as shaped_configuration,
    whole_number as whole_number,
    within as within,
)
from .errors import (
    CertificateError as CertificateError,
    CollisionError as CollisionError,
    InputError as InputError,
    PlanningError as PlanningError,
    SafeOmplError as SafeOmplError,
    StaleSceneError as StaleSceneError,
    UnknownNameError as UnknownNameError,
    listed as listed,
    pass_on as pass_on,
    shown as shown,
    told_apart as told_apart,
    warn_once as warn_once,
)
from .models import (
    Changes as Changes,
    Counts as Counts,
    PerThread as PerThread,
    halton_point as halton_point,
    notebook_html as notebook_html,
)
from .workers import in_order as in_order
