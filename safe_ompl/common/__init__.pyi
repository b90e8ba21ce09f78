from . import documents as documents, files as files, polynomials as polynomials
from .compilation import (
    caller as caller,
    clock as clock,
    compile_together as compile_together,
    compiled as compiled,
    ctrl_c_as_such as ctrl_c_as_such,
    expanded as expanded,
    inlined as inlined,
    maker as maker,
    part as part,
    until_ctrl_c as until_ctrl_c,
)
from .documents import Section as Section, key as key, within as within
from .errors import (
    CertificateError as CertificateError,
    CollisionError as CollisionError,
    InputError as InputError,
    PlanningError as PlanningError,
    SafeOmplError as SafeOmplError,
    StaleSceneError as StaleSceneError,
    UnknownNameError as UnknownNameError,
    pass_on as pass_on,
    warn_once as warn_once,
)
from .inputs import (
    RATE_BOUNDS as RATE_BOUNDS,
    BoolArray as BoolArray,
    FloatArray as FloatArray,
    IntArray as IntArray,
    configuration as configuration,
    configurations as configurations,
    finite_array as finite_array,
    flag as flag,
    float_array as float_array,
    fraction as fraction,
    halton_point as halton_point,
    instance as instance,
    listed as listed,
    motion_ends as motion_ends,
    number as number,
    seed as seed,
    shaped_configuration as shaped_configuration,
    shown as shown,
    told_apart as told_apart,
    whole_number as whole_number,
)
from .machine_code import origin as origin
from .models import Changes as Changes, Counts as Counts, PerThread as PerThread, notebook_html as notebook_html
from .stack import stack_array as stack_array
from .workers import in_order as in_order
