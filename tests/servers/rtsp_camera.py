#!/usr/bin/python3
"""A private RTSP camera for tests, on loopback only, that leaves nothing behind: GStreamer's RTSP server.

    rtsp_camera.py --dir DIR [--format h264|jpeg] [--user]

It sends a moving ball, 320x240 at 30 frames a second. When it takes connections it prints one line on stdout:

    READY rtsp://127.0.0.1:PORT/camera

Then it obeys one command for each line of stdin, as zookeeper.py does: kill, start (the same port), pause (it hangs), resume,
stop. The end of stdin means `stop`. With --user it wants the user and the password of certificates.py.
"""
import sys

import certificates
import private_server

CODECS = {"h264": "openh264enc gop-size=15 ! h264parse ! rtph264pay name=pay0 pt=96",
          "jpeg": "jpegenc ! rtpjpegpay name=pay0 pt=26"}


class RtspCamera(private_server.Server):
    name = "the camera"

    def __init__(self, given):
        super().__init__(given.dir)
        self.given = given
        self.port = private_server.free_ports(1)[0]

    def command(self):
        return ["/usr/bin/python3", __file__, "--dir", self.folder, "--serve", str(self.port), "--format", self.given.format,
                *(["--user"] if self.given.user else [])]

    def url(self):
        return "rtsp://127.0.0.1:%d/camera" % self.port

    def answers(self):
        with self.connect(self.port) as connection:
            connection.settimeout(60)
            connection.sendall(b"OPTIONS %s RTSP/1.0\r\nCSeq: 1\r\n\r\n" % self.url().encode())
            return connection.recv(8) == b"RTSP/1.0"


def serve(given):
    import gi
    gi.require_version("Gst", "1.0")
    gi.require_version("GstRtspServer", "1.0")
    from gi.repository import GLib, Gst, GstRtspServer
    Gst.init(None)
    server = GstRtspServer.RTSPServer()
    server.set_address("127.0.0.1")
    server.set_service(str(given.serve))
    factory = GstRtspServer.RTSPMediaFactory()
    factory.set_launch("( videotestsrc is-live=true pattern=ball ! video/x-raw,width=320,height=240,framerate=30/1 ! "
                       "videoconvert ! video/x-raw,format=I420 ! %s )" % CODECS[given.format])
    if given.user:
        auth = GstRtspServer.RTSPAuth()
        token = GstRtspServer.RTSPToken()
        token.set_string(GstRtspServer.RTSP_TOKEN_MEDIA_FACTORY_ROLE, "user")
        auth.add_basic(GstRtspServer.RTSPAuth.make_basic(certificates.USER, certificates.PASSWORD), token)
        server.set_auth(auth)
        permissions = GstRtspServer.RTSPPermissions()
        permissions.add_permission_for_role("user", "media.factory.access", True)
        permissions.add_permission_for_role("user", "media.factory.construct", True)
        factory.set_permissions(permissions)
    server.get_mount_points().add_factory("/camera", factory)
    if server.attach(None) == 0:
        sys.exit("the port %d cannot be used" % given.serve)
    GLib.MainLoop().run()


def main():
    parser = private_server.options("A private RTSP camera")
    parser.add_argument("--format", choices=sorted(CODECS), default="h264", help="of what it sends")
    parser.add_argument("--user", action="store_true", help="whoever looks must be a user")
    parser.add_argument("--serve", type=int, help="be the camera itself, at this port")
    given = parser.parse_args()
    if given.serve:
        serve(given)
    else:
        private_server.run(lambda: RtspCamera(given))


if __name__ == "__main__":
    main()
