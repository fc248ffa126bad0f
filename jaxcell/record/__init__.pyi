from .bounce.cells_by_direction import save_cells as save_cells
from .data.dataset import dataset as dataset, save_dataset as save_dataset
from .data.deployment_files import save_deployment as save_deployment
from .data.release_files import save_release as save_release
from .data.summary import summary as summary
from .figures.plot import plot as plot
from .figures.rounds import save_rounds as save_rounds
from .figures.sea import save_sea as save_sea
from .recordings import save_recording as save_recording, show as show
from .robot.recording import RobotRecording as RobotRecording
from .robot.track import RecordedRobot as RecordedRobot
from .sweep.overview import log_sweep as log_sweep
