package iotcloud.bench.storm;

import java.io.BufferedReader;
import java.io.InputStreamReader;
import java.io.PrintStream;
import java.nio.charset.StandardCharsets;
import java.util.ArrayList;
import java.util.HashMap;
import java.util.List;
import java.util.Map;
import org.apache.storm.Config;
import org.apache.storm.DaemonConfig;
import org.apache.storm.LocalCluster;
import org.apache.storm.generated.StormTopology;

/**
 * A topology on Storm's LocalCluster, in one worker. Prints {"ready":true} when it works, then answers commands on stdin,
 * one line of JSON each: "count" (what was done so far), "drain" (sends nothing more and waits for all that is under
 * way). It ends when stdin ends.
 */
public final class Main {
    private static final long READY_LIMIT_S = 90;
    private static final long DRAIN_LIMIT_S = 20;
    private static final long SLOW_MS = 1000;
    private static final long SESSION_MS = 60_000;
    private static final long STANDSTILL_S = 600;

    private Main() {}

    public static void main(String[] words) throws Exception {
        PrintStream answers = System.out;
        System.setOut(System.err);
        Options options = new Options(words);
        Config conf = new Config();
        conf.setNumWorkers(1);
        conf.setNumAckers(options.tracked ? 1 : 0);
        conf.putAll(options.conf);
        LocalCluster cluster = new LocalCluster.Builder()
                .withSupervisors(1)
                .withPortsPerSupervisor(1)
                .withDaemonConf(patience())  // first, because it replaces settings made before
                .withDaemonConf(Config.TOPOLOGY_ENABLE_MESSAGE_TIMEOUTS, true)
                .withDaemonConf(Config.STORM_ZOOKEEPER_SERVERS, List.of(options.zookeeperHost))
                .withDaemonConf(Config.STORM_ZOOKEEPER_PORT, options.zookeeperPort)
                .withDaemonConf(Config.STORM_ZOOKEEPER_ROOT, options.zookeeperRoot)
                .build();
        cluster.submitTopology(options.topology, conf, topology(options, conf));
        answer(answers, "{\"ready\":" + becomesReady(options) + "}");
        obey(options, answers);
        Runtime.getRuntime().halt(0);  // the process that started this one removes the folders of the cluster
    }

    /** Time-outs so long that Storm does not take this process for dead, and restarts nothing, while it is stopped. */
    private static Map<String, Object> patience() {
        return new HashMap<>(Map.of(Config.STORM_ZOOKEEPER_SESSION_TIMEOUT, SESSION_MS,
                Config.STORM_ZOOKEEPER_CONNECTION_TIMEOUT, SESSION_MS,
                DaemonConfig.NIMBUS_TASK_TIMEOUT_SECS, STANDSTILL_S,
                DaemonConfig.NIMBUS_SUPERVISOR_TIMEOUT_SECS, STANDSTILL_S,
                Config.SUPERVISOR_WORKER_TIMEOUT_SECS, STANDSTILL_S));
    }

    private static StormTopology topology(Options options, Config conf) throws Exception {
        switch (options.topology) {
            case "echo":
                return Echo.topology(options, conf);
            case "words":
                return Words.topology(options, conf);
            case "chain":
                return Chain.topology(options, conf);
            default:
                throw new IllegalArgumentException("no such topology: " + options.topology);
        }
    }

    private static boolean becomesReady(Options options) throws InterruptedException {
        long limit = System.nanoTime() + READY_LIMIT_S * 1_000_000_000L;
        while (System.nanoTime() < limit) {
            if (options.topology.equals("echo") ? Echo.connected() == 2 * options.drivers : Counters.results() > 0) {
                return true;
            }
            Thread.sleep(10);
        }
        return false;
    }

    private static void obey(Options options, PrintStream answers) throws Exception {
        BufferedReader commands = new BufferedReader(new InputStreamReader(System.in, StandardCharsets.UTF_8));
        for (String command = commands.readLine(); command != null; command = commands.readLine()) {
            if (command.equals("drain")) {
                // Tuples that waited for room in a full queue stay in an unfinished batch, which Storm flushes only
                // when the next tuple goes the same way. So a few more are sent, slowly.
                Counters.feed = Feed.SLOW;
                Thread.sleep(SLOW_MS);
                Counters.feed = Feed.NOTHING;
                long limit = System.nanoTime() + DRAIN_LIMIT_S * 1_000_000_000L;
                while (Counters.results() < expected(options) && System.nanoTime() < limit) {
                    Thread.sleep(10);
                }
            }
            answer(answers, String.format("{\"at_ns\":%d,\"results\":%d,\"expected\":%d,\"failed\":%d}", System.nanoTime(),
                    Counters.results(), expected(options), Counters.failed.get()));
        }
    }

    private static long expected(Options options) {
        return Counters.emitted.get() * (options.topology.equals("words") ? Words.WORDS_OF_SENTENCE : 1);
    }

    private static void answer(PrintStream answers, String line) {
        answers.println(line);
        answers.flush();
    }

    /** The command line. */
    static final class Options {
        final String topology;
        String zookeeperHost = "127.0.0.1";
        long zookeeperPort = 2181;
        String zookeeperRoot = "/storm";
        boolean tracked;
        String url = "";
        String name = "";
        int drivers = 4;
        final Config conf = new Config();

        Options(String[] words) {
            List<String> rest = new ArrayList<>(List.of(words));
            topology = rest.remove(0);
            while (!rest.isEmpty()) {
                String name = rest.remove(0);
                if (name.equals("--tracked")) {
                    tracked = true;
                    continue;
                }
                take(name, rest.remove(0));
            }
        }

        private void take(String option, String value) {
            switch (option) {
                case "--zookeeper":
                    zookeeperHost = value.substring(0, value.indexOf(':'));
                    zookeeperPort = Long.parseLong(value.substring(value.indexOf(':') + 1));
                    break;
                case "--root":
                    zookeeperRoot = value;
                    break;
                case "--url":
                    url = value;
                    break;
                case "--name":
                    name = value;
                    break;
                case "--drivers":
                    drivers = Integer.parseInt(value);
                    break;
                case "--sentences":
                    conf.put(Words.SENTENCES, value);
                    break;
                case "--set":
                    set(value.substring(0, value.indexOf('=')), value.substring(value.indexOf('=') + 1));
                    break;
                default:
                    throw new IllegalArgumentException("no such option: " + option);
            }
        }

        /** A setting of the topology, as in Storm's own YAML. */
        private void set(String key, String value) {
            if (value.equals("true") || value.equals("false")) {
                conf.put(key, Boolean.valueOf(value));
            } else if (value.matches("\\d+")) {
                conf.put(key, Long.valueOf(value));
            } else if (value.matches("\\d*\\.\\d+")) {
                conf.put(key, Double.valueOf(value));
            } else {
                conf.put(key, value);
            }
        }
    }
}
