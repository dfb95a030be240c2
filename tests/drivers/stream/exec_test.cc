#include <chrono>
#include <cstdlib>
#include <string>

#include <gmock/gmock.h>
#include <signal.h>

#include <iotcloud/drivers/exec/exec_driver.h>
#include <iotcloud/tests/drivers/stream/until.h>
#include <iotcloud/tests/files.h>
#include <iotcloud/tests/temporary_folder.h>

namespace iotcloud::drivers::exec {
namespace {

using namespace std::chrono_literals;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using testing::MockInstance;

Descriptor exec() {
  return describe<ExecDriver>("exec", "test", true);
}

/// A program that a shell reads from this text.
PropertyMap script(const std::string& text) {
  return {{"command", "sh -c '" + text + "'"}};
}

TEST(Exec, gives_a_program_commands_and_publishes_its_lines) {
  MockInstance echo(exec(), {{"command", "sed -u s/^/got:/"}});
  ASSERT_TRUE(echo.start()) << echo.error();
  ASSERT_TRUE(echo.deliver("send", command("one")));
  ASSERT_TRUE(echo.deliver("send", command("two")));
  ASSERT_TRUE(until_published(echo, "received", 2));
  EXPECT_THAT(texts(echo, "received"), ElementsAre("got:one", "got:two"));
}

TEST(Exec, logs_what_the_program_writes_to_stderr) {
  MockInstance noisy(exec(), script("echo trouble >&2; printf half >&2; exec 2>&-; cat"));
  ASSERT_TRUE(noisy.start()) << noisy.error();
  ASSERT_TRUE(until(noisy, [&] { return noisy.host().logged_count("the program says: half") == 1; }));
  EXPECT_EQ(noisy.host().logged_count("the program says: trouble"), 1U);
  EXPECT_TRUE(texts(noisy, "received").empty());
}

TEST(Exec, hears_a_program_that_writes_to_stderr_without_end) {
  MockInstance noisy(exec(), script("yes >&2 & echo reading; wait"));
  ASSERT_TRUE(noisy.start()) << noisy.error();
  ASSERT_TRUE(until_published(noisy, "received", 1));
  EXPECT_THAT(texts(noisy, "received"), ElementsAre("reading"));
}

TEST(Exec, starts_a_program_again_that_ended_after_pauses_that_grow) {
  PropertyMap properties = script("echo started; exit 3");
  properties["reconnect_ms"] = "100";
  MockInstance brief(exec(), properties);
  ASSERT_TRUE(brief.start()) << brief.error();
  const std::string problem = "the program is not running: it exited with status 3";
  ASSERT_TRUE(until_metadata(brief, "connection_problem", problem));
  EXPECT_EQ(brief.host().metadata().count("process"), 0U);
  brief.host().advance(100ms);
  ASSERT_TRUE(until_published(brief, "received", 2));
  ASSERT_TRUE(until_metadata(brief, "connection_problem", problem));
  brief.host().advance(199ms);
  EXPECT_EQ(brief.host().published("received").size(), 2U);
  brief.host().advance(1ms);
  ASSERT_TRUE(until_published(brief, "received", 3));
}

TEST(Exec, leaves_a_program_alone_that_has_done_its_work) {
  PropertyMap properties = script("echo done");
  properties["restart"] = "on-failure";
  MockInstance work(exec(), properties);
  ASSERT_TRUE(work.start()) << work.error();
  ASSERT_TRUE(until(work, [&] { return work.host().logged_count("is not started again") == 1; }));
  work.host().advance(1h);
  EXPECT_THAT(texts(work, "received"), ElementsAre("done"));
  properties["command"] = "sh -c 'kill -9 $$'";
  MockInstance killed(exec(), properties);
  ASSERT_TRUE(killed.start()) << killed.error();
  ASSERT_TRUE(
      until_metadata(killed, "connection_problem", "the program is not running: it was ended by the signal Killed"));
}

TEST(Exec, publishes_all_that_a_program_wrote_before_it_ended_and_ends_what_it_started) {
  MockInstance burst(exec(), script("seq 20000; sleep 1000 & exit"));
  ASSERT_TRUE(burst.start()) << burst.error();
  burst.host().answer_publish("received", PublishStatus::would_block);
  ASSERT_GT(burst.host().poll_descriptors(60s), 0U);
  burst.host().answer_publish("received", PublishStatus::accepted);
  ASSERT_TRUE(burst.writable("received"));
  ASSERT_TRUE(until_metadata(burst, "connection", "away"));
  const auto lines = texts(burst, "received");
  ASSERT_EQ(lines.size(), 20'000U);
  EXPECT_EQ(lines.back(), "20000");
}

TEST(Exec, says_which_program_cannot_be_started) {
  MockInstance missing(exec(), {{"command", "no-such-program --now"}});
  ASSERT_TRUE(missing.start()) << missing.error();
  EXPECT_EQ(missing.host().metadata()["connection_problem"],
            "no-such-program cannot be started: No such file or directory");
}

TEST(Exec, ends_a_program_with_its_instance_by_a_signal_or_by_force) {
  const tests::TemporaryFolder folder;
  PropertyMap patient = script("trap \"echo bye > " + (folder / "bye") +
                               "; exit\" TERM; echo ready; while :; do read x || sleep 1000 & wait; done");
  patient["grace_ms"] = "8000";
  MockInstance polite(exec(), patient);
  ASSERT_TRUE(polite.start()) << polite.error();
  ASSERT_TRUE(until_published(polite, "received", 1));
  polite.close();
  EXPECT_EQ(tests::read_file(folder / "bye"), "bye\n");
  PropertyMap properties = script("trap : TERM; echo ready; while :; do sleep 0.01; done");
  properties["grace_ms"] = "50";
  MockInstance stubborn(exec(), properties);
  ASSERT_TRUE(stubborn.start()) << stubborn.error();
  ASSERT_TRUE(until_published(stubborn, "received", 1));
  const pid_t process = std::stoi(stubborn.host().metadata()["process"]);
  EXPECT_EQ(kill(process, 0), 0);
  stubborn.close();
  EXPECT_EQ(kill(process, 0), -1);
}

TEST(Exec, gives_a_program_no_variables_but_the_usual_and_those_that_are_named) {
  setenv("IOTCLOUD_SECRET", "hidden", 1);
  PropertyMap properties = script("echo $IOTCLOUD_SECRET/$CITY/$PWD; cat");
  properties["environment"] = "'CITY=New York' A=b";
  properties["folder"] = "/usr";
  MockInstance shell(exec(), properties);
  ASSERT_TRUE(shell.start()) << shell.error();
  ASSERT_TRUE(until_published(shell, "received", 1));
  EXPECT_THAT(texts(shell, "received"), ElementsAre("/New York//usr"));
}

TEST(Exec, takes_a_command_apart_as_a_shell_does) {
  EXPECT_THAT(words_of("a  'b c' \"d \\\" e\" f\\ g ''"), ElementsAre("a", "b c", "d \" e", "f g", ""));
  EXPECT_TRUE(words_of("  ").empty());
  EXPECT_THROW(words_of("'a"), std::invalid_argument);
  const auto error_with = [](const PropertyMap& properties) {
    MockInstance instance(exec(), properties);
    EXPECT_FALSE(instance.open());
    return instance.error();
  };
  EXPECT_THAT(error_with({{"command", " "}}), HasSubstr("\"command\" is empty"));
  EXPECT_THAT(error_with({{"command", "a \"b"}}), HasSubstr("has no end"));
  EXPECT_THAT(error_with({{"command", "a"}, {"environment", "B"}}), HasSubstr("NAME=VALUE"));
  EXPECT_THAT(error_with({{"command", "a"}, {"grace_ms", "9000"}}), HasSubstr("8000"));
}

}  // namespace
}  // namespace iotcloud::drivers::exec
