#!/usr/bin/python3
"""A simulated TurtleBot as a ROS node of its own, for tests.

    ros_robot.py --dir DIR --program FILE --master URL [--lockstep] [--seed N]

Runs the program ros_robot (tests/drivers/turtle/ros/robot_main.cc) with its trace and log below DIR. When it is
registered with the master it prints one line on stdout:

    READY FILE OF THE TRACE

Then it obeys one command for each line of stdin, as zookeeper.py does: kill, start (another robot, with a trace from the
beginning), pause, resume, stop. The end of stdin means `stop`.
"""
import os

import private_server


class RosRobot(private_server.Server):
    name = "the robot"

    def __init__(self, given):
        super().__init__(given.dir)
        self.given = given

    def command(self):
        return [self.given.program, "--trace", self.url(), "--seed", str(self.given.seed),
                *(["--lockstep"] if self.given.lockstep else [])]

    def environment(self):
        return {**os.environ, "ROS_IP": "127.0.0.1", "ROS_MASTER_URI": self.given.master, "ROS_HOME": self.folder}

    def url(self):
        return self.path("trace.csv")

    def launch(self):
        if os.path.exists(self.url()):
            os.remove(self.url())
        super().launch()

    def answers(self):
        return os.path.exists(self.url())


def main():
    parser = private_server.options("A simulated TurtleBot on ROS")
    parser.add_argument("--program", required=True, help="the program ros_robot")
    parser.add_argument("--master", required=True, help="URL of the ROS master")
    parser.add_argument("--lockstep", action="store_true", help="its world moves on when a frame was answered")
    parser.add_argument("--seed", type=int, default=1, help="of its world")
    given = parser.parse_args()
    private_server.run(lambda: RosRobot(given))


if __name__ == "__main__":
    main()
