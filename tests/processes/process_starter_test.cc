// The end of a starter's socket that runs under the other account, when what comes is no request.
#include <array>
#include <string>
#include <vector>

#include <fcntl.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/socket.h>
#include <unistd.h>

#include <iotcloud/processes/frames.h>
#include <iotcloud/processes/process_starter.h>
#include <iotcloud/processes/starter_protocol.h>
#include <iotcloud/processes/unix_socket.h>

namespace iotcloud::processes {
namespace {

using testing::HasSubstr;

class Starter : public testing::Test {
 protected:
  /// What the other end answers to these bytes, the first of which comes with so many descriptors.
  static StarterAnswer answer_to(const std::string& bytes, std::size_t descriptors) {
    std::array<int, 2> ends{};
    EXPECT_EQ(socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0, ends.data()), 0);
    const OwnedDescriptor ours(ends[0]);
    send(ours, bytes, descriptors);
    shutdown(ours.get(), SHUT_WR);
    EXPECT_EQ(serve_starter(OwnedDescriptor(ends[1]), "/bin/false"), 1);
    FrameReader frames;
    while (const auto received = receive_some(ours)) frames.feed(received->data(), received->size());
    return decode_answer(frames.next().value_or(""));
  }

 private:
  static void send(const OwnedDescriptor& socket, const std::string& bytes, std::size_t descriptors) {
    const OwnedDescriptor null(open("/dev/null", O_RDWR | O_CLOEXEC));
    const std::vector<int> sent(descriptors, null.get());
    alignas(cmsghdr) std::array<char, 256> control{};
    iovec all{const_cast<char*>(bytes.data()), bytes.size()};
    msghdr message{};
    message.msg_iov = &all;
    message.msg_iovlen = 1;
    if (descriptors > 0) {
      message.msg_control = control.data();
      message.msg_controllen = CMSG_SPACE(sizeof(int) * descriptors);
      cmsghdr* const header = CMSG_FIRSTHDR(&message);
      header->cmsg_level = SOL_SOCKET;
      header->cmsg_type = SCM_RIGHTS;
      header->cmsg_len = CMSG_LEN(sizeof(int) * descriptors);
      std::copy_n(reinterpret_cast<const char*>(sent.data()), sizeof(int) * descriptors,
                  reinterpret_cast<char*>(CMSG_DATA(header)));
    }
    EXPECT_EQ(sendmsg(socket.get(), &message, MSG_NOSIGNAL), static_cast<ssize_t>(bytes.size()));
  }
};

TEST_F(Starter, RunsNothingForWhatIsNoRequest) {
  const std::string unknown = "this request is none that this version knows";
  for (const std::string& body :
       {std::string(), std::string("run"), std::string("run\0", 4), std::string("run\0001\0", 6),
        std::string("run\0002\0a\0", 8), std::string("run\000-1\0a\0", 9), std::string("run\0001x\0a\0", 9),
        std::string("run\0001\0a", 7), std::string("kill\0009\0", 7), std::string("stop\0", 5)}) {
    EXPECT_EQ(answer_to(frame(body), 2).reason, unknown) << body;
  }
  EXPECT_THAT(answer_to(std::string(1, '\0'), 2).reason, HasSubstr("did not come whole"));
  EXPECT_THAT(answer_to("\xff\xff\xff\xff", 2).reason, HasSubstr("the limit is"));
}

TEST_F(Starter, RunsAndKillsNothingWithoutTheDescriptorsForIt) {
  const std::string run = encode(StarterRequest{StarterRequest::Kind::run, {"host"}, {}});
  const std::string kill = encode(StarterRequest{StarterRequest::Kind::kill, {}, {}});
  EXPECT_THAT(answer_to(run, 0).reason, HasSubstr("0 descriptors instead of 2"));
  EXPECT_THAT(answer_to(run, 1).reason, HasSubstr("1 descriptors instead of 2"));
  EXPECT_THAT(answer_to(kill, 2).reason, HasSubstr("2 descriptors instead of 1"));
  EXPECT_THAT(answer_to(kill, 1).reason, HasSubstr("cannot be killed")) << "it is no process";
}

TEST_F(Starter, AnswersOfWhichNoneIsKnownAreNoStatus) {
  for (const std::string& body :
       {std::string("started\0001\0", 10), std::string("ended\0x\0", 8), std::string("ended\0", 6)}) {
    std::array<int, 2> ends{};
    ASSERT_EQ(socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0, ends.data()), 0);
    const OwnedDescriptor ours(ends[0]), theirs(ends[1]);
    ASSERT_TRUE(send_all(theirs, frame(body)));
    EXPECT_EQ(status_of(ours), std::nullopt) << body;
  }
}

}  // namespace
}  // namespace iotcloud::processes
