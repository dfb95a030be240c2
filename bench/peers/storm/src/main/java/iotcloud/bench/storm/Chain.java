package iotcloud.bench.storm;

import org.apache.storm.Config;
import org.apache.storm.generated.StormTopology;
import org.apache.storm.topology.BasicOutputCollector;
import org.apache.storm.topology.OutputFieldsDeclarer;
import org.apache.storm.topology.TopologyBuilder;
import org.apache.storm.topology.base.BaseBasicBolt;
import org.apache.storm.tuple.Fields;
import org.apache.storm.tuple.Tuple;
import org.apache.storm.tuple.Values;

/** Source, pass, sink, a number: as bench/runtime's chain. */
final class Chain {
    private Chain() {}

    static StormTopology topology(Main.Options options, Config conf) {
        TopologyBuilder builder = new TopologyBuilder();
        builder.setSpout("source", new Numbers(options.tracked));
        builder.setBolt("pass", new Pass()).shuffleGrouping("source");
        builder.setBolt("sink", new Sink(options.tracked)).shuffleGrouping("pass");
        return builder.createTopology();
    }

    private static final class Numbers extends Source {
        Numbers(boolean tracked) {
            super(tracked, 1);
        }

        @Override
        Values item(long number) {
            return new Values(number);
        }

        @Override
        public void declareOutputFields(OutputFieldsDeclarer declarer) {
            declarer.declare(new Fields("n"));
        }
    }

    static final class Pass extends BaseBasicBolt {
        @Override
        public void execute(Tuple tuple, BasicOutputCollector collector) {
            collector.emit(new Values(tuple.getValue(0)));
        }

        @Override
        public void declareOutputFields(OutputFieldsDeclarer declarer) {
            declarer.declare(new Fields("n"));
        }
    }

    private static final class Sink extends LastBolt {
        Sink(boolean tracked) {
            super(tracked);
        }

        @Override
        void take(Tuple tuple) {}
    }
}
