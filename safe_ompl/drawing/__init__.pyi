from . import plots as plots
from .content import (
    RECORDING_ENDING as RECORDING_ENDING,
    ViewerContent as ViewerContent,
    read_recording as read_recording,
)
from .page import PLOT_ENDINGS as PLOT_ENDINGS
from .pictures import (
    ANIMATION_ENDINGS as ANIMATION_ENDINGS,
    draw_plan as draw_plan,
    draw_program as draw_program,
    render_comparison as render_comparison,
    render_path as render_path,
    save_animation as save_animation,
    save_picture as save_picture,
    small_picture as small_picture,
)
from .surfaces import RobotBody as RobotBody
from .viewer import BrowserView as BrowserView, save_page as save_page, view as view
