package iotcloud.bench.storm;

import java.io.IOException;
import java.io.UncheckedIOException;
import java.nio.file.Files;
import java.nio.file.Path;
import java.util.HashMap;
import java.util.Map;
import org.apache.storm.Config;
import org.apache.storm.generated.StormTopology;
import org.apache.storm.spout.SpoutOutputCollector;
import org.apache.storm.task.TopologyContext;
import org.apache.storm.topology.BasicOutputCollector;
import org.apache.storm.topology.OutputFieldsDeclarer;
import org.apache.storm.topology.TopologyBuilder;
import org.apache.storm.topology.base.BaseBasicBolt;
import org.apache.storm.tuple.Fields;
import org.apache.storm.tuple.Tuple;
import org.apache.storm.tuple.Values;

/** Source -> split (2) -> by word -> count (2): the word count of bench/runtime, with the same sentences. */
final class Words {
    static final int WORDS_OF_SENTENCE = 10;
    static final String SENTENCES = "bench.sentences";  // the file with the sentences, one in a line

    private Words() {}

    static StormTopology topology(Main.Options options, Config conf) {
        TopologyBuilder builder = new TopologyBuilder();
        builder.setSpout("source", new Sentences(options.tracked));
        builder.setBolt("split", new Split(), 2).shuffleGrouping("source");
        builder.setBolt("count", new Count(options.tracked), 2).fieldsGrouping("split", new Fields("word"));
        return builder.createTopology();
    }

    private static final class Sentences extends Source {
        private transient String[] all;

        Sentences(boolean tracked) {
            super(tracked, WORDS_OF_SENTENCE);
        }

        @Override
        public void open(Map<String, Object> conf, TopologyContext context, SpoutOutputCollector collector) {
            super.open(conf, context, collector);
            try {
                all = Files.readAllLines(Path.of((String) conf.get(SENTENCES))).toArray(new String[0]);
            } catch (IOException error) {
                throw new UncheckedIOException(error);
            }
        }

        @Override
        Values item(long number) {
            return new Values(all[(int) (number % all.length)]);
        }

        @Override
        public void declareOutputFields(OutputFieldsDeclarer declarer) {
            declarer.declare(new Fields("sentence"));
        }
    }

    static final class Split extends BaseBasicBolt {
        @Override
        public void execute(Tuple tuple, BasicOutputCollector collector) {
            String sentence = tuple.getString(0);
            int begin = 0;
            for (int end = sentence.indexOf(' '); end >= 0; end = sentence.indexOf(' ', begin)) {
                collector.emit(new Values(sentence.substring(begin, end)));
                begin = end + 1;
            }
            collector.emit(new Values(sentence.substring(begin)));
        }

        @Override
        public void declareOutputFields(OutputFieldsDeclarer declarer) {
            declarer.declare(new Fields("word"));
        }
    }

    private static final class Count extends LastBolt {
        private transient Map<String, Long> words;

        Count(boolean tracked) {
            super(tracked);
        }

        @Override
        public void prepare(Map<String, Object> conf, TopologyContext context) {
            super.prepare(conf, context);
            words = new HashMap<>();
        }

        @Override
        void take(Tuple tuple) {
            words.merge(tuple.getString(0), 1L, Long::sum);
        }
    }
}
