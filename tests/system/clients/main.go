// main URL PHOTOGRAPH: a photograph, then four frames of a camera, half a second apart.
package main

import (
	"context"
	"encoding/json"
	"fmt"
	"log"
	"os"

	client "github.com/GIT_USER_ID/GIT_REPO_ID"
)

func photograph() *os.File {
	file, err := os.Open(os.Args[2])
	if err != nil {
		log.Fatal(err)
	}
	return file
}

func main() {
	configuration := client.NewConfiguration()
	configuration.Servers = client.ServerConfigurations{{URL: os.Args[1]}}
	api, background := client.NewAPIClient(configuration), context.Background()
	pose, _, err := api.PoseAPI.EstimatePose(background).Frame(photograph()).Execute()
	if err != nil {
		log.Fatal(err)
	}
	times := []float64{}
	for frame := 0; frame < 4; frame++ {
		call := api.CamerasAPI.TrackFrame(background, "go").Frame(photograph())
		// The generator writes fractions with 32 bits.
		reply, _, err := call.TimestampMs(1795880000250 + 500*int64(frame)).Execute()
		if err != nil {
			log.Fatal(err)
		}
		times = append(times, reply.Timestamp)
	}
	said, _ := json.Marshal(map[string]any{"width": pose.Image.Width, "times": times})
	fmt.Println(string(said))
}
