package mix;

import iotcloud.storm.CppBolt;
import iotcloud.storm.CppGrouping;
import iotcloud.storm.CppSpout;
import iotcloud.storm.PlainJson;
import java.util.Map;
import org.apache.storm.Config;
import org.apache.storm.StormSubmitter;
import org.apache.storm.policy.WaitStrategyPark;
import org.apache.storm.topology.BoltDeclarer;
import org.apache.storm.topology.TopologyBuilder;
import org.apache.storm.tuple.Fields;

/** Submits what mix.yaml describes, built in Java: `storm jar mixed.jar mix.Main FILE ROUNDS`. */
public final class Main {
  private static final String LIBRARY = "storm_mix.so";

  private Main() {}

  public static void main(String[] words) throws Exception {
    String file = words[0];
    int rounds = Integer.parseInt(words[1]);
    TopologyBuilder builder = new TopologyBuilder();
    builder.setSpout("readings", new CppSpout(LIBRARY, "mix.Readings", Map.of("rounds", rounds)));

    builder.setBolt("cpp", new CppBolt(LIBRARY, "mix.Relay"), 2)
        .customGrouping("readings", new CppGrouping(LIBRARY, "mix.BySign"));
    builder.setBolt("python", new Python("relay.py", "name", "number", "level", "by"), 2).shuffleGrouping("readings");
    builder.setBolt("java", new Relay(), 2).shuffleGrouping("readings");

    byKey(builder.setBolt("names", new CppBolt(LIBRARY, "mix.CountNames"), 3), "name");
    byKey(builder.setBolt("numbers", new Python("count_numbers.py", "key", "by", "count", "task"), 3), "number");
    byKey(builder.setBolt("levels", new CountLevels(), 3), "level");

    builder.setBolt("table", new Table(file))
        .globalGrouping("names").globalGrouping("numbers").globalGrouping("levels")
        .globalGrouping("readings", "finished");
    StormSubmitter.submitTopology("mix", conf(), builder.createTopology());
  }

  private static void byKey(BoltDeclarer counter, String field) {
    for (String relay : new String[] {"cpp", "python", "java"}) {
      counter.fieldsGrouping(relay, new Fields(field));
    }
  }

  /** As in mix.yaml, which says why. */
  private static Config conf() {
    String park = WaitStrategyPark.class.getName();
    Config conf = new Config();
    conf.setNumWorkers(2);
    conf.setMaxSpoutPending(100);
    conf.setMessageTimeoutSecs(300);
    conf.put(Config.TOPOLOGY_SUBPROCESS_TIMEOUT_SECS, 300);
    conf.put(Config.TOPOLOGY_MULTILANG_SERIALIZER, PlainJson.class.getName());
    conf.put(Config.TOPOLOGY_SPOUT_WAIT_STRATEGY, park);
    conf.put(Config.TOPOLOGY_SPOUT_WAIT_PARK_MICROSEC, 5000);
    conf.put(Config.TOPOLOGY_BOLT_WAIT_STRATEGY, park);
    conf.put(Config.TOPOLOGY_BOLT_WAIT_PARK_MICROSEC, 5000);
    conf.put(Config.TOPOLOGY_BACKPRESSURE_WAIT_STRATEGY, park);
    conf.put(Config.TOPOLOGY_BACKPRESSURE_WAIT_PARK_MICROSEC, 5000);
    conf.put(Config.TOPOLOGY_WORKER_CHILDOPTS, "-XX:ErrorFile=artifacts/hs_err_%p.log");
    return conf;
  }
}
